"""Parses the EDS file with two libraries and compares it with the table from which it was generated.

Arguments: the EDS file; the table, one `index sub type access mappable least most` a line, in hex but for access and -.
"""

import sys

import canopen
import dcf
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

NODE = 0x10
ARRAYS = (0x1003, 0x1016, 0x1029)

path, table = sys.argv[1], sys.argv[2]
assert dcf.lint(dcf.parse_file(path)), "Lely's linter reports an error"
theirs = dcf.Device.from_dcf(path, {"NODEID": NODE})
ours = canopen.import_od(path, NODE)
assert (ours.device_information.LSS_supported, ours.device_information.nr_of_RXPDO) == (False, 1)

expected = {}
for line in table.splitlines():
    index, sub, kind, access, mappable, least, most = line.split()
    limits = tuple(None if limit == "-" else int(limit, 16) for limit in (least, most))
    expected[int(index, 16), int(sub, 16)] = (int(kind, 16), access, mappable == "1", limits)

seen = {}
for entry in ours.values():
    if not isinstance(entry, ODVariable):
        assert isinstance(entry, ODArray if entry.index in ARRAYS else ODRecord), hex(entry.index)
    for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
        limits = (variable.min, variable.max)
        seen[variable.index, variable.subindex] = (
            variable.data_type, variable.access_type, variable.pdo_mappable, limits,
        )
assert seen == expected, [item for item in seen.items() ^ expected.items()]

for (index, sub), (kind, access, mappable, limits) in expected.items():
    entry = theirs[index][sub]
    read = (entry.data_type.index, entry.access_type.name, entry.pdo_mapping)
    assert read == (kind, access, mappable), f"{index:04X}h {sub}: {read}"
    default = ours.get_variable(index, sub).default
    if kind != 9 and default is not None:
        assert entry.default_value.parse({"NODEID": NODE}) == default, f"{index:04X}h {sub}"
assert sum(len(theirs[index]) for index in theirs) == len(expected)
print("passed")
