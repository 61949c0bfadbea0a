"""Hears what a broker is sent, with other people's clients, and prints one JSON object per message.

    target/mqtt-clients/bin/python tools/peers/mqtt_clients.py json PORT SCHEMA
    target/mqtt-clients/bin/python tools/peers/mqtt_clients.py sparkplug PORT

`json` (paho) validates every message of flankscope/# against its part of the schema and adds what is wrong as `invalid`.
`sparkplug` (pysparkplug) decodes every message of spBv1.0/#; a line on standard input, GROUP NODE, asks that node for its births.
"""

import json
import sys

from paho.mqtt import client as paho


def say(**what):
    print(json.dumps(what), flush=True)


def listener(port, protocol, topic, heard):
    client = paho.Client(protocol=protocol)
    client.on_message = lambda client, data, message: heard(message)
    client.on_connect = lambda client, *_: client.subscribe(topic, 1)
    client.on_subscribe = lambda *_: say(ready=True)
    client.connect("127.0.0.1", port)
    return client


def listen_json(port, schema):
    import jsonschema

    with open(schema) as file:
        schema = json.load(file)
    validators = {
        kind: jsonschema.Draft202012Validator({"$ref": f"#/$defs/{kind}", "$defs": schema["$defs"]})
        for kind in ("check", "state", "status")
    }

    def heard(message):
        payload = json.loads(message.payload)
        kind = message.topic.rsplit("/", 1)[1]
        invalid = [error.message for error in validators[kind].iter_errors(payload)]
        say(topic=message.topic, qos=message.qos, retained=bool(message.retain), payload=payload, invalid=invalid)

    listener(port, paho.MQTTv5, "flankscope/#", heard).loop_forever()


def listen_sparkplug(port):
    from pysparkplug import DataType, Message, Metric, NCmd, QoS, Topic, get_current_timestamp
    from pysparkplug._protobuf import Payload

    births = {}

    def heard(message):
        topic = Topic.from_str(message.topic)
        kind = topic.message_type.value
        if kind == "NCMD":
            return
        key = (topic.edge_node_id, topic.device_id)
        decoded = Message.from_mqtt_message(message, birth=births.get(key)).payload
        if kind.endswith("BIRTH"):
            births[key] = decoded
        raw = Payload.FromString(message.payload)
        properties = {
            metric.name: {
                key: value.string_value if value.type == DataType.STRING else value.int_value
                for key, value in zip(metric.properties.keys, metric.properties.values)
            }
            for metric in raw.metrics
        }
        metrics = [decoded.bd_seq_metric] if kind == "NDEATH" else getattr(decoded, "metrics", [])
        say(
            kind=kind,
            node=topic.edge_node_id,
            device=topic.device_id,
            retained=bool(message.retain),
            seq=getattr(decoded, "seq", None),
            metrics={
                metric.name: {
                    "value": metric.value,
                    "type": metric.datatype.name,
                    "null": metric.is_null,
                    "historical": metric.is_historical,
                    **properties[metric.name],
                }
                for metric in metrics
            },
        )

    client = listener(port, paho.MQTTv311, "spBv1.0/#", heard)
    client.loop_start()
    for line in sys.stdin:
        group, node = line.split()
        rebirth = Metric(
            timestamp=get_current_timestamp(), name="Node Control/Rebirth", datatype=DataType.BOOLEAN, value=True
        )
        command = NCmd(timestamp=get_current_timestamp(), metrics=(rebirth,))
        client.publish(f"spBv1.0/{group}/NCMD/{node}", command.encode(include_dtypes=True), QoS.AT_MOST_ONCE)


if sys.argv[1] == "json":
    listen_json(int(sys.argv[2]), sys.argv[3])
else:
    listen_sparkplug(int(sys.argv[2]))
