// A Raspberry Pi Pico for the tests: rp2040js runs the image; this program models the chip's surroundings.
//
//   node main.js ELF --sockets FOLDER --outputs MASK [--flash FILE] [--can] [--reboot] [--ram BYTE] [--cut OPERATIONS [--torn]]
//
// Connects to these sockets in FOLDER: `control`, with one line per command, answer and event; `gripper` (UART0),
// `bus` (UART1) and `service` (USB). With --can, an MCP2515 is on SPI0; its model communicates over standard input
// and output. During sleep the machine's time follows the wall clock; otherwise it runs as fast as it can. It stops
// periodically until all peers have caught up: event `time MICROS`, answered by the line `go on`, which has no reply.
//
// Commands: `in PIN LEVEL`; `read ADDRESS LEN`; `time`; `error UART KIND EVERY`, `error UART none`; `cut OPERATIONS`;
// `derail HOW`, from the next watchdog feed on; `resets`: number of watchdog resets, and MICROS from the last feed to
// the last one. Answers: `ok ...`, `refused WHY`. Events: `out LEVELS` of the pins in MASK; `served LEVELS`, the
// first levels with all pins driven; `reset`; `end WHY`.
"use strict";

const fs = require("node:fs");
const net = require("node:net");
const path = require("node:path");
const { parseArgs } = require("node:util");
const { RP2040 } = require("rp2040js");
const { Flash, hex } = require("./flash.js");
const { Pl011 } = require("./pl011.js");
const { SpiToModel } = require("./spi.js");
const { UsbHost } = require("./usb.js");
const { Watchdog } = require("./watchdog.js");

const { values: options, positionals } = parseArgs({
    allowPositionals: true,
    options: {
        sockets: { type: "string" },
        outputs: { type: "string" },
        flash: { type: "string" },
        can: { type: "boolean", default: false },
        reboot: { type: "boolean", default: false },
        ram: { type: "string", default: "0" },
        cut: { type: "string" },
        torn: { type: "boolean", default: false },
    },
});

// From the pin table of boards/pico.
const BUS_DRIVER = 6;
const CAN_SELECT = 17, CAN_INTERRUPT = 20;
const SPI0 = 0x4003c, UARTS = [0x40034, 0x40038], UART_INTERRUPTS = [20, 21], IO_BANK0 = 0x40014, GPIO_OUT_XOR = 0x1c, NVIC_ICPR = 0x280;

// Stack pointer and entry after the boot ROM (data sheet, 2.8.1.4).
const BOOT_STACK = 0x20041f00, BOOT_ENTRY = 0x10000000;

// Lead of the machine's time over the wall clock for which no pause is made, because no host can make one so short;
// and maximum lag that is caught up.
const AHEAD_NANOS = 1e6, LATE_NANOS = 50e6;
// Wall-clock interval for checking commands and bytes, and maximum lead over the peers.
const SLICE_MILLIS = 1, AHEAD_OF_OTHERS_NANOS = 2e6;

// Delay before reporting pins that firmware drives one by one: shorter than any input filter of a PLC.
const SETTLE_NANOS = 5000;

// Minimum number of bytes to pass on while a line is still sending.
const PIECE = [16, 256, 1];

const outputMask = Number(options.outputs);

class Pico {
    constructor() {
        this.flash = new Flash(fs.readFileSync(positionals[0]), options.flash ?? null, (why) => this.end(why));
        if (options.cut) this.flash.cut = Number(options.cut);
        this.flash.isTorn = options.torn;
        this.ended = null;
        this.inputs = 0;
        this.shown = 0;
        this.isServed = this.isToldServed = false;
        this.errors = [null, null];
        const connect = (name) => net.connect(path.join(options.sockets, name)).on("error", () => {});
        this.lines = ["gripper", "bus", "service"].map(connect);
        this.lines.forEach((line, n) => line.on("data", (bytes) => this.onLine(n, bytes)));
        this.toSend = this.lines.map(() => []);
        this.control = connect("control").on("data", (text) => this.onControl(text)).on("close", () => process.exit());
        this.partial = "";
        // The machine's time as known to the peers, and whether it waits for them.
        this.toldNanos = 0;
        this.isHeld = false;
        this.offset = 0;
        this.model = options.can ? new SpiToModel() : null;
        this.watchdog = new Watchdog();
        this.powerUp(0);
        this.offset = this.wall();
    }

    // Resets the machine. Flash, time, watchdog state and line errors persist.
    powerUp(nanos) {
        this.rp2040 = new RP2040();
        const { rp2040 } = this;
        rp2040.sram.fill(Number(options.ram));
        this.clock = rp2040.clock;
        this.clock.nanosCounter = nanos;
        rp2040.logger = {
            debug() {},
            info() {},
            // Hardware has all peripherals that rp2040js lacks, but not all memory.
            warn: (name, message) => message.match(/invalid|undefined/) && this.end(`${message}, PC ${hex(rp2040.core.PC)}`),
            error: (name, message) => this.end(`${name}: ${message}, PC ${hex(rp2040.core.PC)}`),
        };
        this.watchdog.install(rp2040, { reset: () => (this.isReset = true), fail: (why) => this.end(why) });
        this.isReset = false;
        this.settled = this.clock.createAlarm(() => this.show());
        this.flash.install(rp2040);
        this.correctCore();
        this.uarts = UARTS.map((address, n) => {
            const send = (byte) => this.toSend[n].push(byte);
            const driver = () => n === 0 || this.isHigh(BUS_DRIVER);
            const uart = new Pl011(rp2040, `UART${n}`, UART_INTERRUPTS[n], { send, driver, complain: (why) => this.end(why) });
            rp2040.peripherals[address] = rp2040.uart[n] = uart;
            uart.setError(...(this.errors[n] ?? [null]));
            return uart;
        });
        this.usb = new UsbHost(rp2040.usbCtrl, (bytes) => this.toSend[2].push(...bytes));
        for (let pin = 0; pin < 30; pin++) rp2040.gpio[pin].setInputValue(((this.inputs >> pin) & 1) !== 0);
        for (const [of, address] of [[rp2040.sio], [rp2040.peripherals[IO_BANK0]]]) {
            const write = of.writeUint32.bind(of);
            of.writeUint32 = (offset, value) => {
                write(offset, value);
                if (offset < 0x100) this.look(of === rp2040.sio && offset <= GPIO_OUT_XOR && (value & outputMask) !== 0);
            };
        }
        if (this.model) {
            this.setInput(CAN_INTERRUPT, true);
            this.model.connect(rp2040, rp2040.spi[0], {
                isSelected: () => !this.isHigh(CAN_SELECT),
                setInterrupt: (level) => this.setInput(CAN_INTERRUPT, level),
                fail: (why) => this.end(why),
            });
        }
        rp2040.core.SP = BOOT_STACK;
        rp2040.core.PC = BOOT_ENTRY;
        this.look();
    }

    // Corrects rp2040js to ARMv6-M (B1.5, B3.4). It takes masked exceptions during sleep, does not wake for SysTick,
    // drops software-pended interrupts when their line falls, and has an odd program counter in handlers, which
    // breaks table jumps. Correct: a rising line pends its interrupt, as a store to ISPR does. Handler entry clears
    // it, and a line still high on return pends it again.
    correctCore() {
        const { core, ppb } = this.rp2040;
        let lines = 0, active = 0;
        const pend = (bits) => {
            core.pendingInterrupts |= bits;
            core.interruptsUpdated = true;
        };
        core.setInterrupt = (irq, value) => {
            const bit = 1 << irq;
            if (value && !(lines & bit)) pend(bit);
            lines = value ? lines | bit : lines & ~bit;
        };
        const { exceptionEntry, exceptionReturn } = core;
        core.exceptionEntry = (number) => {
            if (number >= 16) {
                core.pendingInterrupts &= ~(1 << (number - 16));
                active |= 1 << (number - 16);
            }
            exceptionEntry.call(core, number);
            core.PC &= ~1;
        };
        core.exceptionReturn = (value) => {
            const left = core.IPSR >= 16 ? 1 << (core.IPSR - 16) : 0;
            exceptionReturn.call(core, value);
            active &= ~left;
            pend(lines & left);
        };
        const write = ppb.writeUint32;
        ppb.writeUint32 = (offset, value) => {
            if (offset !== NVIC_ICPR) return write.call(ppb, offset, value);
            core.pendingInterrupts &= ~value;
            return pend(lines & value & ~active);
        };
        this.mayWake = () =>
            (core.pendingInterrupts & core.enabledInterrupts) !== 0 ||
            core.pendingSystick ||
            core.pendingPendSV ||
            core.pendingNMI;
    }

    isHigh(pin) {
        const { outputEnable, outputValue } = this.rp2040.gpio[pin];
        return outputEnable && outputValue;
    }

    setInput(pin, level) {
        this.inputs = level ? this.inputs | (1 << pin) : this.inputs & ~(1 << pin);
        this.rp2040.gpio[pin].setInputValue(level);
    }

    // Checks the pins after a store; `isLevels` means that it set output levels. The first such store with all
    // outputs driven is the main loop's.
    look(isLevels = false) {
        if (!this.settled.scheduled && this.levels() !== this.shown) this.settled.schedule(SETTLE_NANOS);
        if (isLevels && !this.isServed && this.levels("outputEnable") === outputMask) {
            this.isServed = true;
            this.settled.schedule(SETTLE_NANOS);
        }
        this.model?.look();
    }

    // Returns the high outputs, or the driven ones, as a mask.
    levels(what = "outputValue") {
        let levels = 0;
        for (let pin = 0; pin < 30; pin++) {
            const gpio = this.rp2040.gpio[pin];
            if ((outputMask >> pin) & 1 && gpio.outputEnable && gpio[what]) levels |= 1 << pin;
        }
        return levels;
    }

    show() {
        const levels = this.levels();
        this.settled.scheduled = false;
        if (levels !== this.shown) this.tell(`out ${(this.shown = levels)}`);
        if (this.isServed && !this.isToldServed) {
            this.isToldServed = true;
            this.tell(`served ${levels}`);
        }
    }

    tell(line) {
        this.control.write(line + "\n");
    }

    end(why) {
        if (this.ended !== null) return;
        this.ended = why;
        this.tell(`end ${why}`);
    }

    onLine(n, bytes) {
        this.wakeUp();
        if (n === 2) this.usb.send(bytes);
        else this.uarts[n].receive(bytes);
        this.goOn();
    }

    onControl(text) {
        this.wakeUp();
        const lines = (this.partial + text).split("\n");
        this.partial = lines.pop();
        for (const line of lines) {
            if (line === "go on") {
                this.isHeld = false;
                // After bytes that arrived together with it on the other lines.
                setImmediate(() => this.run());
                continue;
            }
            try {
                const answer = this.command(line.split(" "));
                this.tell(answer === undefined ? "ok" : `ok ${answer}`);
            } catch (error) {
                this.tell(`refused ${error.message}`);
            }
        }
        this.goOn();
    }

    command([command, ...words]) {
        const numbers = words.map(Number);
        switch (command) {
            case "in":
                return this.setInput(numbers[0], numbers[1] !== 0);
            case "read": {
                const [address, len] = numbers;
                let digits = "";
                for (let at = address; at < address + len; at++) digits += hex(this.rp2040.readUint8(at)).slice(-2);
                return digits;
            }
            case "time":
                return Math.floor(this.clock.nanosCounter / 1000);
            case "error": {
                const [kind, every] = [words[1] === "none" ? null : words[1], numbers[2]];
                this.errors[numbers[0]] = [kind, every];
                return this.uarts[numbers[0]].setError(kind, every);
            }
            case "derail":
                this.watchdog.derailment = words[0];
                return undefined;
            case "resets":
                return `${this.watchdog.resets} ${Math.ceil(this.watchdog.lastedNanos / 1000)}`;
            case "cut":
                this.flash.cut = numbers[0];
                return undefined;
            default:
                throw new Error(`unknown command ${command}`);
        }
    }

    // The machine's time if it never lagged.
    wall() {
        return performance.now() * 1e6 - this.offset;
    }

    // Advances a sleeping machine to now, unless an interrupt has ended the sleep: its handler runs first. Otherwise a
    // byte could arrive before the firmware has taken the one before it.
    wakeUp() {
        const { clock } = this;
        if (!this.rp2040.core.waiting || this.mayWake()) return;
        const until = Math.min(this.wall(), clock.nextAlarm?.nanos ?? Infinity, this.untilNanos);
        if (until > clock.nanosCounter) clock.tick(until - clock.nanosCounter);
    }

    goOn() {
        if (this.pause) {
            clearTimeout(this.pause);
            this.pause = null;
            this.run();
        }
    }

    // Time at which it must wait for the peers; while it waits, the current time.
    get untilNanos() {
        return this.isHeld ? this.clock.nanosCounter : this.toldNanos + AHEAD_OF_OTHERS_NANOS;
    }

    get isRunning() {
        return this.ended === null && !this.isReset;
    }

    run() {
        const { clock, flash, untilNanos } = this;
        const { core } = this.rp2040;
        const until = performance.now() + SLICE_MILLIS;
        const cycleNanos = 1e9 / this.rp2040.clkSys;
        let late = this.wall() - clock.nanosCounter;
        if (late > LATE_NANOS) this.offset += late - LATE_NANOS;
        do {
            for (let n = 0; n < 1000 && this.isRunning && clock.nanosCounter < untilNanos; n++) {
                if (!core.waiting) {
                    let nanos = core.executeInstruction() * cycleNanos;
                    if (!flash.isMapped) nanos += this.unmapped();
                    // Inlined clock.tick, which would be called per instruction.
                    clock.nanosCounter += nanos;
                    if (clock.nextAlarm !== null && clock.nextAlarm.nanos <= clock.nanosCounter) clock.tick(0);
                } else if (this.mayWake()) {
                    core.waiting = false;
                    core.interruptsUpdated = true;
                } else {
                    const alarm = Math.min(clock.nextAlarm?.nanos ?? Infinity, untilNanos);
                    const ahead = alarm - this.wall();
                    if (ahead > AHEAD_NANOS) {
                        this.flush();
                        this.pause = setTimeout(() => this.goOn(), Math.min(Math.floor(ahead / 1e6), 1000));
                        return;
                    }
                    clock.nanosCounter = alarm;
                    clock.tick(0);
                }
            }
        } while (this.isRunning && clock.nanosCounter < untilNanos && performance.now() < until);
        this.flush();
        if (this.isReset) this.restart();
        if (this.ended !== null) return;
        if (clock.nanosCounter < untilNanos) setImmediate(() => this.run());
        else this.hold();
    }

    // Waits until the peers have caught up.
    hold() {
        this.toldNanos = this.clock.nanosCounter;
        this.isHeld = true;
        this.tell(`time ${Math.floor(this.toldNanos / 1000)}`);
    }

    // Returns the time taken by the flash, and ensures that no code runs from it meanwhile.
    unmapped() {
        const { PC } = this.rp2040.core;
        if (PC >>> 24 === 0x10) this.end(`${hex(PC)} ran from the flash while it was not mapped`);
        return this.flash.takeNanos();
    }

    // Passes on sent bytes. Frames are sent whole, because gaps on a busy host would break them for a master.
    flush() {
        this.lines.forEach((line, n) => {
            const bytes = this.toSend[n];
            if (!bytes.length || (this.uarts[n]?.isSending && bytes.length < PIECE[n])) return;
            if (!line.destroyed) line.write(Uint8Array.from(bytes));
            bytes.length = 0;
        });
    }

    restart() {
        if (!options.reboot) return this.end("the firmware has reset itself");
        this.powerUp(this.clock.nanosCounter);
        this.tell("reset");
    }
}

const pico = new Pico();
pico.run();
