"""A client of other people (asyncua) for the plant's OPC UA server.

    target/opcua-clients/bin/python tools/peers/opcua_clients.py FOLDER

It obeys commands, one JSON object a line, and answers each with one line: "answer", or "refused" with the status. What a
subscription brings comes as lines "change" and "event" between them. Certificates are made in FOLDER.
"""

import asyncio
import json
import logging
import math
import sys
from datetime import datetime
from pathlib import Path

from asyncua import Client, ua
from asyncua.common.events import get_filter_from_event_type
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.security_policies import (
    SecurityPolicyAes256Sha256RsaPss,
    SecurityPolicyBasic256Sha256,
)
from cryptography.x509.oid import ExtendedKeyUsageOID

POLICIES = {
    "Basic256Sha256": SecurityPolicyBasic256Sha256,
    "Aes256_Sha256_RsaPss": SecurityPolicyAes256Sha256RsaPss,
}
NAMESPACE = "urn:flankscope:plant"


def say(**line):
    print(json.dumps(line), flush=True)


def plain(value):
    """A value as JSON: structures by the names of their fields, enumerations by their names, what is no number as null."""
    if isinstance(value, ua.LocalizedText):
        return value.Text
    if isinstance(value, (ua.NodeId, ua.QualifiedName)):
        return value.to_string()
    if isinstance(value, datetime):
        return value.isoformat()
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if hasattr(value, "name") and isinstance(value, int):
        return value.name
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__ if name != "Encoding"}
    return value


def status(code):
    return ua.status_codes.get_name_and_doc(code.value)[0]


class Handler:
    """Says what a subscription brings."""

    def __init__(self, paths):
        self.paths = paths

    def datachange_notification(self, node, value, data):
        if node.nodeid not in self.paths:
            # The server's library begins also those of events with "waiting for data".
            return
        code = data.monitored_item.Value.StatusCode
        say(change=self.paths[node.nodeid], value=plain(value), status=status(code))

    def event_notification(self, event):
        fields = event.get_event_props_as_fields_dict()
        say(event={name: plain(variant.Value) for name, variant in fields.items()})

    def status_change_notification(self, change):
        say(subscription=status(change.Status))


class Session:
    """A connection and what was browsed over it."""

    def __init__(self, folder):
        self.folder = folder
        self.client = None
        self.nodes = {}
        self.others = []

    async def certificate(self, name):
        key, certificate = (self.folder / f"{name}.{end}" for end in ("key.pem", "der"))
        for file in (key, certificate):
            file.unlink(missing_ok=True)
        uri = f"urn:client:{name}"
        await setup_self_signed_certificate(key, certificate, uri, "localhost", [ExtendedKeyUsageOID.CLIENT_AUTH], {})
        return str(certificate)

    async def connected(self, url, user, password, certificate=None, policy=None, mode="SignAndEncrypt"):
        client = Client(url, timeout=10)
        client.application_uri = f"urn:client:{certificate}"
        if user is not None:
            client.set_user(user)
            client.set_password(password)
        if policy is not None:
            await client.set_security(
                POLICIES[policy],
                certificate=str(self.folder / f"{certificate}.der"),
                private_key=str(self.folder / f"{certificate}.key.pem"),
                mode=ua.MessageSecurityMode[mode],
            )
        await client.connect()
        return client

    async def connect(self, **how):
        self.client = await self.connected(**how)
        self.nodes = {}

    async def disconnect(self):
        client, self.client = self.client, None
        await client.disconnect()

    async def crowd(self, most, **how):
        """Opens sessions until one is refused; how many there were."""
        for count in range(most):
            try:
                self.others.append(await self.connected(**how))
            except (ua.UaError, OSError, asyncio.TimeoutError) as error:
                return {"sessions": count, "refused": type(error).__name__}
        return {"sessions": most, "refused": None}

    async def leave(self):
        for client in self.others:
            await client.disconnect()
        self.others = []

    async def endpoints(self, url):
        """What is said without security."""
        found = await Client(url, timeout=10).connect_and_get_server_endpoints()
        return [
            {
                "url": endpoint.EndpointUrl,
                "policy": endpoint.SecurityPolicyUri.rsplit("#", 1)[1],
                "mode": endpoint.SecurityMode.name,
                "tokens": [token.TokenType.name for token in endpoint.UserIdentityTokens],
            }
            for endpoint in found
        ]

    async def browse(self):
        """Every node below this server's own ones, by its path, with its value."""
        self.nodes = {}
        objects = self.client.nodes.objects
        for child in await objects.get_children():
            name = await child.read_browse_name()
            if name.Name in ("Machines", "Plant"):
                await self.walk(child, name.Name)
        found = {}
        for path, (node, kind) in self.nodes.items():
            found[path] = {"class": kind.name, "id": node.nodeid.to_string()}
            if kind == ua.NodeClass.Variable:
                found[path] |= await self.value(node)
        return found

    async def walk(self, node, path):
        self.nodes[path] = (node, await node.read_node_class())
        for child in await node.get_children():
            name = await child.read_browse_name()
            await self.walk(child, f"{path}|{name.Name}")

    async def value(self, node):
        data = await node.read_data_value(raise_on_bad_status=False)
        value = data.Value.Value if data.Value is not None else None
        return {"value": plain(value), "status": status(data.StatusCode)}

    async def read(self, path):
        return await self.value(self.nodes[path][0])

    async def write(self, path, value):
        await self.nodes[path][0].write_value(value)

    async def types(self):
        return sorted(await self.client.load_data_type_definitions())

    async def subscribe(self, paths, events=None, of_status=False):
        """Values of these paths, on request also when their status alone changes, and events of a node: the server itself or one of
        the paths."""
        by_node = {self.nodes[path][0].nodeid: path for path in paths}
        subscription = await self.client.create_subscription(100, Handler(by_node))
        changes = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValue) if of_status else None
        for path in paths:
            await subscription._subscribe(self.nodes[path][0], mfilter=changes)
        if events is not None:
            index = await self.client.get_namespace_index(NAMESPACE)
            kind = self.client.get_node(ua.NodeId(1001, index))
            source = self.client.nodes.server if events == "Server" else self.nodes[events][0]
            # By its type: the server's library compares no node identifiers, with which this client would list types. And with a
            # queue: for that library none asked for means one event.
            chosen = await get_filter_from_event_type([kind], where_clause_generation=False)
            of_type = ua.ContentFilterElement(FilterOperator=ua.FilterOperator.OfType)
            of_type.FilterOperands.append(ua.LiteralOperand(Value=ua.Variant(kind.nodeid)))
            chosen.WhereClause.Elements.append(of_type)
            await subscription.subscribe_events(source, kind, evfilter=chosen, queuesize=100)

    async def call(self, path, arguments):
        method, _ = self.nodes[path]
        parent = self.nodes[path.rsplit("|", 1)[0]][0]
        types = (ua.VariantType.Int64, ua.VariantType.String)
        typed = [ua.Variant(value, kind) for value, kind in zip(arguments, types)]
        await parent.call_method(method, *typed)


async def obey(folder):
    session = Session(folder)
    loop = asyncio.get_running_loop()
    while line := await loop.run_in_executor(None, sys.stdin.readline):
        command = json.loads(line)
        do = getattr(session, command.pop("do"))
        try:
            say(answer=await do(**command))
        except (ua.UaError, OSError, asyncio.TimeoutError) as error:
            say(refused=type(error).__name__, why=str(error))


logging.disable(logging.CRITICAL)
asyncio.run(obey(Path(sys.argv[1])))
