# minimalmodbus as a master of the bridge: the functions for cycle.py, and its other functions.
import sys
import minimalmodbus
client = minimalmodbus.Instrument(sys.argv[1], 1)
client.serial.baudrate = 19200
client.serial.timeout = 5

def again(call):
    for attempt in range(5):
        try:
            return call()
        except (minimalmodbus.NoResponseError, minimalmodbus.InvalidResponseError) as error:
            last = error
    raise last

def read(address, count):
    return again(lambda: client.read_registers(address, count))

def inputs(address, count):
    return again(lambda: client.read_registers(address, count, functioncode=4))

def write(address, values):
    again(lambda: client.write_registers(address, values))

def coil(address, value):
    again(lambda: client.write_bit(address, int(value)))

# cycle.py

try:
    client.read_register(4)
    raise SystemExit("register 4 must not exist")
except minimalmodbus.IllegalRequestError:
    pass
assert client.read_bits(0, 16, functioncode=2)[0] == 1
assert read(100, 1) == [1], "the unit"
