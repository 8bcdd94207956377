# modbus-tk as a master of the bridge: the functions for cycle.py, and its other functions.
import sys
import modbus_tk.defines as fc
from modbus_tk.exceptions import ModbusError
from modbus_tk.modbus_rtu import RtuMaster

# line.py

client = RtuMaster(line)
client.set_timeout(TIMEOUT)

def ask(*arguments, **more):
    return client.execute(1, *arguments, **more)

def read(address, count):
    return list(ask(fc.READ_HOLDING_REGISTERS, address, count))

def inputs(address, count):
    return list(ask(fc.READ_INPUT_REGISTERS, address, count))

def write(address, values):
    assert ask(fc.WRITE_MULTIPLE_REGISTERS, address, output_value=values) == (address, len(values))

def coil(address, value):
    assert ask(fc.WRITE_SINGLE_COIL, address, output_value=int(value))[0] == address

# cycle.py

try:
    ask(fc.READ_HOLDING_REGISTERS, 4, 1)
    raise SystemExit("register 4 must not exist")
except ModbusError as error:
    assert error.get_exception_code() == 2, error
try:
    ask(fc.WRITE_SINGLE_REGISTER, 100, output_value=0)
    raise SystemExit("UNIT must reject 0")
except ModbusError as error:
    assert error.get_exception_code() == 3, error
assert ask(fc.READ_DISCRETE_INPUTS, 0, 16)[0] == 1
assert ask(fc.READ_COILS, 0, 16) == (0,) * 16
assert ask(fc.WRITE_MULTIPLE_COILS, 8, output_value=[1, 0, 1, 0, 0, 0, 0, 1]) == (8, 8)
assert read(0, 1) == [0x85], read(0, 1)
# Registers 0 and 1 are read after the write to register 1.
answer = ask(fc.READ_WRITE_MULTIPLE_REGISTERS, 0, 2, output_value=[4001], write_starting_address_fc23=1)
assert list(answer) == [0x85, 4001], answer
assert read(100, 1) == [1], "the unit"
