# A grip cycle with the master of pyprofibus over the given pseudo terminal, which refuses parity. The GSD file is the only
# source of the slave's parameters.
import sys
import time

import serial

serial.PARITY_EVEN = serial.PARITY_NONE
from pyprofibus.dp_master import DPM1, DpSlaveDesc
from pyprofibus.gsd.interp import GsdInterp
from pyprofibus.phy_serial import CpPhySerial

phy = CpPhySerial(port=sys.argv[1])
phy.setConfig(baudrate=19200)
master = DPM1(phy, masterAddr=2)
gripper = DpSlaveDesc()
gripper.slaveAddr = gripper.setPrmTelegram.da = gripper.chkCfgTelegram.da = 7
gsd = GsdInterp.fromFile(sys.argv[2])
gripper.identNumber = gripper.setPrmTelegram.identNumber = gsd.getIdentNumber()
# Directions as seen by the slave.
gripper.inputSize, gripper.outputSize = 8, 12
gripper.setCfgDataElements(gsd.getCfgDataElements())
gripper.setSyncMode(False)
gripper.setFreezeMode(False)
# A limit for a busy machine.
gripper.setWatchdog(10_000)
master.addSlave(gripper)
master.initialize()


def rise(flags):
    """Prints every edge, for the test to compare with the commands that the gripper received."""
    print(f"edge {flags:02x}", flush=True)
    return flags


def run(flags, is_done, what):
    """Writes these flags until the input image meets the condition."""
    end = time.monotonic() + 600
    exchanges, image, written = 0, None, rise(flags)
    while time.monotonic() < end:
        if not gripper.isConnected():
            # On a busy machine, answers may exceed this master's time-out, and it connects again. Its first outputs are then
            # not an edge, so the program writes zeros and raises the flags again.
            exchanges, written = 0, 0
        # WIDTH 20 mm, SPEED 100 mm/s, FORCELIMIT 40 N.
        gripper.setMasterOutData(bytearray([written, 0, 0x07, 0xD0, 0x27, 0x10, 0x0F, 0xA0]))
        master.run()
        data = gripper.getMasterInData()
        if data is None:
            continue
        image = bytes(data)
        exchanges += 1
        # The first inputs may precede the flags.
        if exchanges > 3 and is_done(image):
            return
        if exchanges > 3 and written != flags:
            exchanges, written = 0, rise(flags)
    sys.exit(f"time-out; expected {what}: {image!r}")


def shows(state):
    return lambda image: image[0] == state and image[10:12] == b"\0\0"


IDLE, HOLDING = 0x01, 0x10
run(0x00, lambda image: True, "inputs")
run(0x10, lambda image: not image[3] & 0x10, "FAST STOP to end")
run(0x00, lambda image: True, "inputs")
run(0x08, lambda image: image[2] & 1 and shows(IDLE)(image), "HOMING")
run(0x00, lambda image: True, "inputs")
run(0x02, shows(HOLDING), "GRIP")
run(0x00, shows(HOLDING), "HOLDING")
run(0x04, shows(IDLE), "RELEASE")
