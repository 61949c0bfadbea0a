"""Reads a DFQ file with another's reader (aqdefreader): one JSON object with some of the part's fields, and each characteristic's with its values.

dfq_reader.py FILE
"""

import contextlib
import json
import sys

from aqdefreader import read_dfq_file

# The reader says on the standard output what it does.
with contextlib.redirect_stdout(sys.stderr):
    file = read_dfq_file(sys.argv[1])
parts = file.get_parts()
assert len(parts) == 1, len(parts)
part = parts[0]
json.dump(
    {
        "part": {key: part.get_data(key) for key in ("K1001", "K1002", "K1206", "K1802", "K1900")},
        "characteristics": [
            {
                "fields": {key: of.get_data(key) for key in of.get_data_keys()},
                "values": [
                    {"value": m.value, "attribute": m.attribute, "time": str(m.datetime)}
                    for m in of.get_measurements()
                ],
            }
            for of in part.get_characteristics()
        ],
    },
    sys.stdout,
)
