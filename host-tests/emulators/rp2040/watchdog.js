// Completes rp2040js's watchdog (RP2040 data sheet, 4.7): tick rate, scope of a reset, and persistent state. Also
// makes the firmware hang on request.
"use strict";

const { BasePeripheral } = require("rp2040js");

const WATCHDOG = 0x40058, PSM = 0x40010, VREG_AND_CHIP_RESET = 0x40064;
const LOAD = 0x04, TICK = 0x2c;
// TICK: cycles of CLK_REF per tick.
const CYCLES = 0x1ff;
// PSM_WDSEL: everything except the two oscillators.
const ALL = 0x1fffc;
// CHIP_RESET (2.12.8): power-on reset; unaffected by watchdog resets.
const CHIP_RESET = 0x08, HAD_POR = 1 << 8;

// A loop and vectors to it, in RAM that neither static data nor the stack uses.
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
        // Time of the last feed, and time from it to the last reset.
        this.fedNanos = this.lastedNanos = 0;
        // How the firmware hangs from the next feed on: `loop`, with interrupts; `masked`, without; `handler`.
        this.derailment = null;
    }

    // Installs it in a machine after any reset. `reset()` resets the machine; `fail(why)` ends it.
    install(rp2040, { reset, fail }) {
        rp2040.peripherals[VREG_AND_CHIP_RESET] = new ChipReset(rp2040, "VREG_AND_CHIP_RESET");
        const registers = rp2040.peripherals[WATCHDOG];
        registers.reason = this.reason;
        registers.scratchData = this.scratch;
        registers.onWatchdogTrigger = () => {
            // Otherwise it would trigger again immediately.
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
            // Erratum RP2040-E1: it counts down twice per tick.
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
