# pymodbus as a master that updates the bridge: blocks as file records, then the commands. Arguments: terminal, image in hexadecimal.
import sys
import time

from pymodbus import FramerType
from pymodbus.client import ModbusSerialClient
from pymodbus.pdu.file_message import FileRecord

PATIENCE, KEY, CHECKS, RECEIVED = 60, 0x5AA5, 2, 3
BLOCK = 200
client = ModbusSerialClient(
    sys.argv[1], framer=FramerType.RTU, baudrate=115_200, timeout=PATIENCE, retries=0
)
assert client.connect()
image = bytes.fromhex(sys.argv[2])


def checked(answer):
    assert not answer.isError(), answer
    return answer


for at in range(0, len(image), BLOCK):
    record = FileRecord(1 + at // 20_000, at % 20_000 // 2, image[at : at + BLOCK])
    checked(client.write_file_record([record], device_id=1))
checked(client.write_register(203, KEY, device_id=1))
bound = time.monotonic() + PATIENCE
while (state := checked(client.read_input_registers(212, count=1, device_id=1)).registers) != [RECEIVED]:
    assert state == [CHECKS] and time.monotonic() < bound, state
checked(client.write_register(204, KEY, device_id=1))
print("passed")
