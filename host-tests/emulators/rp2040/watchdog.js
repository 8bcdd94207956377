// The watchdog of the RP2040 (data sheet, 4.7), where rp2040js has less than the hardware: the rate of its tick, what it resets,
// and what stays over a reset. And a firmware that hangs.
"use strict";

const { BasePeripheral } = require("rp2040js");

const WATCHDOG = 0x40058, PSM = 0x40010, VREG_AND_CHIP_RESET = 0x40064;
const LOAD = 0x04, TICK = 0x2c;
// TICK: cycles of CLK_REF in a tick.
const CYCLES = 0x1ff;
// PSM_WDSEL: everything but the two oscillators.
const ALL = 0x1fffc;
// CHIP_RESET (2.12.8): the power came. No reset by the watchdog changes it.
const CHIP_RESET = 0x08, HAD_POR = 1 << 8;

// Where RAM is neither static nor the stack: a loop, and vectors that lead there.
const LOOP_AT = 0x20020000, LOOP = 0xe7fe, VECTORS_AT = 0x20020100, VECTORS = 48;

class ChipReset extends BasePeripheral {
    readUint32(offset) {
        return offset === CHIP_RESET ? HAD_POR : super.readUint32(offset);
    }
}

class Watchdog {
    constructor() {
        this.reason = 0;
        this.scratch = new Uint32Array(8);
        this.resets = 0;
        // When it was fed, and how long after that it reset the machine last.
        this.fedNanos = this.lastedNanos = 0;
        // How the firmware is to hang from the next time on that it feeds it: `loop`, with interrupts; `masked`, without; `handler`.
        this.derailment = null;
    }

    // Puts it into a machine that power or it has reset. `reset()` does that; `fail(why)` ends the machine.
    install(rp2040, { reset, fail }) {
        rp2040.peripherals[VREG_AND_CHIP_RESET] = new ChipReset(rp2040, "VREG_AND_CHIP_RESET");
        const registers = rp2040.peripherals[WATCHDOG];
        registers.reason = this.reason;
        registers.scratchData = this.scratch;
        registers.onWatchdogTrigger = () => {
            // It would go off again and again in this very moment.
            registers.alarm.enable = false;
            const { wdsel } = rp2040.peripherals[PSM];
            if ((wdsel & ALL) !== ALL) return fail(`the watchdog resets 0x${wdsel.toString(16)} of PSM_WDSEL, not all`);
            this.reason = registers.reason;
            this.resets++;
            this.lastedNanos = rp2040.clock.nanos - this.fedNanos;
            reset();
        };
        let cycles = 0;
        const setRate = () => {
            // Erratum RP2040-E1: it counts down twice in a tick.
            registers.timer.frequency = (2 * rp2040.clocks.refFreq) / Math.max(cycles, 1);
        };
        const { updateClocks } = rp2040;
        rp2040.updateClocks = () => {
            updateClocks.call(rp2040);
            setRate();
        };
        const write = registers.writeUint32;
        registers.writeUint32 = (offset, value) => {
            write.call(registers, offset, value);
            if (offset === TICK) {
                cycles = value & CYCLES;
                setRate();
            } else if (offset === LOAD) {
                this.fedNanos = rp2040.clock.nanos;
                this.derail(rp2040);
            }
        };
    }

    derail(rp2040) {
        const { derailment } = this;
        if (derailment === null) return;
        this.derailment = null;
        const { core } = rp2040;
        rp2040.writeUint16(LOOP_AT, LOOP);
        if (derailment === "handler") {
            for (let n = 0; n < VECTORS; n++) rp2040.writeUint32(VECTORS_AT + 4 * n, LOOP_AT | 1);
            core.VTOR = VECTORS_AT;
        } else {
            core.PM = derailment === "masked";
            core.PC = LOOP_AT;
        }
    }
}

module.exports = { Watchdog };
