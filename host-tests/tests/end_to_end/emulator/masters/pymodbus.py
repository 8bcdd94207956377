# pymodbus as a master of the bridge: the functions for cycle.py, and its other functions.
import sys
from pymodbus.client import ModbusSerialClient
from pymodbus import FramerType
client = ModbusSerialClient(sys.argv[1], framer=FramerType.RTU, baudrate=19200, parity="N", timeout=60, retries=0)
assert client.connect()

def checked(answer):
    assert not answer.isError(), answer
    return answer

def read(address, count):
    return checked(client.read_holding_registers(address, count=count, device_id=1)).registers

def inputs(address, count):
    return checked(client.read_input_registers(address, count=count, device_id=1)).registers

def write(address, values):
    checked(client.write_registers(address, values, device_id=1))

def coil(address, value):
    checked(client.write_coil(address, value, device_id=1))

# cycle.py

answer = client.read_holding_registers(4, count=1, device_id=1)
assert answer.isError() and answer.exception_code == 2, answer
answer = client.readwrite_registers(read_address=0, read_count=4, write_address=1, values=[4001], device_id=1)
assert checked(answer).registers == [0, 4001, 5000, 4000], answer
checked(client.mask_write_register(address=1, and_mask=0xF0F0, or_mask=0x0101, device_id=1))
assert read(1, 1) == [(4001 & 0xF0F0) | (0x0101 & ~0xF0F0 & 0xFFFF)], read(1, 1)
assert checked(client.read_coils(0, count=16, device_id=1)).bits == [False] * 16
assert checked(client.read_discrete_inputs(0, count=1, device_id=1)).bits[0] is True
identity = checked(client.read_device_information(read_code=1, object_id=0, device_id=1)).information
assert identity[1] == b"wsg-bridge-fw", identity
assert checked(client.diag_query_data(b"\x12\x34", device_id=1)).message == b"\x12\x34"
assert read(100, 1) == [1], "the unit"
