# modbus-tk as a master of the bridge: the functions for cycle.py, and its other functions.
import sys
import serial
import modbus_tk.defines as fc
from modbus_tk.exceptions import ModbusError, ModbusInvalidResponseError
from modbus_tk.modbus_rtu import RtuMaster
client = RtuMaster(serial.Serial(sys.argv[1], baudrate=19200, parity="N", timeout=5))
client.set_timeout(5)

def again(*arguments, **more):
    for attempt in range(5):
        try:
            return client.execute(1, *arguments, **more)
        except ModbusInvalidResponseError as error:
            last = error
    raise last

def read(address, count):
    return list(again(fc.READ_HOLDING_REGISTERS, address, count))

def inputs(address, count):
    return list(again(fc.READ_INPUT_REGISTERS, address, count))

def write(address, values):
    assert again(fc.WRITE_MULTIPLE_REGISTERS, address, output_value=values) == (address, len(values))

def coil(address, value):
    assert again(fc.WRITE_SINGLE_COIL, address, output_value=int(value))[0] == address

# cycle.py

try:
    again(fc.READ_HOLDING_REGISTERS, 4, 1)
    raise SystemExit("register 4 must not exist")
except ModbusError as error:
    assert error.get_exception_code() == 2, error
try:
    again(fc.WRITE_SINGLE_REGISTER, 100, output_value=0)
    raise SystemExit("UNIT must reject 0")
except ModbusError as error:
    assert error.get_exception_code() == 3, error
assert again(fc.READ_DISCRETE_INPUTS, 0, 16)[0] == 1
assert again(fc.READ_COILS, 0, 16) == (0,) * 16
assert again(fc.WRITE_MULTIPLE_COILS, 8, output_value=[1, 0, 1, 0, 0, 0, 0, 1]) == (8, 8)
assert read(0, 1) == [0x85], read(0, 1)
# Registers 0 and 1 are read after the write to register 1.
answer = again(fc.READ_WRITE_MULTIPLE_REGISTERS, 0, 2, output_value=[4001], write_starting_address_fc23=1)
assert list(answer) == [0x85, 4001], answer
assert read(100, 1) == [1], "the unit"
