# minimalmodbus as a master of the bridge: the functions for cycle.py, and its other functions.
import sys
import minimalmodbus

# line.py

client = minimalmodbus.Instrument(line, 1)

def read(address, count):
    return client.read_registers(address, count)

def inputs(address, count):
    return client.read_registers(address, count, functioncode=4)

def write(address, values):
    client.write_registers(address, values)

def coil(address, value):
    client.write_bit(address, int(value))

# cycle.py

try:
    client.read_register(4)
    raise SystemExit("register 4 must not exist")
except minimalmodbus.IllegalRequestError:
    pass
assert client.read_bits(0, 16, functioncode=2)[0] == 1
assert read(100, 1) == [1], "the unit"
