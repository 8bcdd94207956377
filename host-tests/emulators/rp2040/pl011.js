// Model of the RP2040's UARTs, per its data sheet (4.2) and ARM's DDI 0183: FIFOs, levels, time-out, errors, and line
// timing.
//
// rp2040js sends bytes instantly and models neither levels nor errors.
"use strict";

const { BasePeripheral } = require("rp2040js");

const DR = 0x000, RSR = 0x004, FR = 0x018, IBRD = 0x024, FBRD = 0x028, LCR_H = 0x02c, CR = 0x030, IFLS = 0x034;
const IMSC = 0x038, RIS = 0x03c, MIS = 0x040, ICR = 0x044, DMACR = 0x048;

// FR
const TXFE = 1 << 7, RXFF = 1 << 6, TXFF = 1 << 5, RXFE = 1 << 4, BUSY = 1 << 3;
// LCR_H
const BRK = 1 << 0, PEN = 1 << 1, STP2 = 1 << 3, FEN = 1 << 4;
// CR
const UARTEN = 1 << 0, LBE = 1 << 7, TXE = 1 << 8, RXE = 1 << 9;
// RIS, MIS, IMSC, ICR
const OE = 1 << 10, BE = 1 << 9, PE = 1 << 8, FE = 1 << 7, RT = 1 << 6, TX = 1 << 5, RX = 1 << 4;
// Error bits of a received byte in DR and RSR, from bit 8 on, and their interrupts.
const ERRORS = { framing: [1 << 8, FE], parity: [1 << 9, PE], break: [1 << 10, BE] };
const OVERRUN = 1 << 11;

const DEPTH = 32;
// IFLS: eighths of a full FIFO (4.2.8).
const LEVELS = [4, 8, 16, 24, 28];
// Idle bit times after which received bytes raise an interrupt below the level.
const TIMEOUT_BITS = 32;

class Pl011 extends BasePeripheral {
    // `send(byte)` receives sent bytes; `driver()` returns whether the line's driver is on, if it has one.
    constructor(rp2040, name, irq, { send, driver, complain }) {
        super(rp2040, name);
        Object.assign(this, { irq, send, driver, complain });
        this.ibrd = this.fbrd = this.lcr = this.imsc = this.raw = this.rsr = this.dmacr = 0;
        this.cr = RXE | TXE;
        this.ifls = 0x12;
        this.toSend = [];
        this.shifting = null;
        this.received = [];
        this.lost = false;
        // Bytes on the wire towards this UART, and the error of every n-th byte.
        this.arriving = [];
        this.error = null;
        this.sent = rp2040.clock.createAlarm(() => this.endOfSent());
        this.arrived = rp2040.clock.createAlarm(() => this.endOfArrived());
        this.timeout = rp2040.clock.createAlarm(() => this.raise(RT));
    }

    get depth() {
        return this.lcr & FEN ? DEPTH : 1;
    }

    get bitNanos() {
        const divider = this.ibrd + this.fbrd / 64;
        return divider ? (16e9 * divider) / this.rp2040.clkPeri : 1e9 / 115200;
    }

    // Start, data, parity and stop bits.
    get characterNanos() {
        const data = 5 + ((this.lcr >> 5) & 3);
        return this.bitNanos * (1 + data + (this.lcr & PEN ? 1 : 0) + (this.lcr & STP2 ? 2 : 1));
    }

    get baudRate() {
        return Math.round(1e9 / this.bitNanos);
    }

    get isSending() {
        return this.shifting !== null;
    }

    level(shift) {
        return this.lcr & FEN ? LEVELS[(this.ifls >> shift) & 7] : 1;
    }

    raise(flags) {
        this.raw |= flags;
        this.updateInterrupt();
    }

    updateInterrupt() {
        this.rp2040.setInterrupt(this.irq, (this.raw & this.imsc) !== 0);
    }

    // Receives bytes from the other end of the line at line speed.
    receive(bytes) {
        for (const byte of bytes) this.arriving.push(byte);
        if (!this.arrived.scheduled && this.arriving.length) this.arrived.schedule(this.characterNanos);
    }

    // Injects error `kind` into every `every`-th byte from now on; null stops it.
    setError(kind, every) {
        this.error = kind ? { kind, every, count: 0 } : null;
    }

    endOfArrived() {
        this.arrived.scheduled = false;
        const byte = this.arriving.shift();
        this.endOfCharacter(byte);
        if (this.arriving.length) this.arrived.schedule(this.characterNanos);
    }

    endOfCharacter(byte) {
        if ((this.cr & (UARTEN | RXE)) !== (UARTEN | RXE)) return;
        const { error } = this;
        const isWrong = error && ++error.count % error.every === 0;
        if (this.received.length >= this.depth || (isWrong && error.kind === "overrun")) {
            this.lost = true;
            this.rsr |= 1 << 3;
            this.raise(OE);
            return;
        }
        let entry = byte;
        if (isWrong && error.kind === "noise") {
            // The PL011 does not report noise; a bit is wrong.
            entry ^= 1 << error.count % 8;
        } else if (isWrong) {
            const [flag, interrupt] = ERRORS[error.kind];
            // A framing error corrupts the byte.
            entry = (error.kind === "framing" ? byte ^ 0x80 : error.kind === "parity" ? byte ^ 1 : 0) | flag;
            this.raw |= interrupt;
        }
        if (this.lost) {
            entry |= OVERRUN;
            this.lost = false;
        }
        this.received.push(entry);
        if (this.received.length >= this.level(3)) this.raw |= RX;
        if (this.lcr & FEN) this.timeout.schedule(TIMEOUT_BITS * this.bitNanos);
        this.updateInterrupt();
    }

    takeReceived() {
        const entry = this.received.shift() ?? 0;
        this.rsr = (this.rsr & 8) | ((entry >> 8) & 7);
        if (this.received.length < this.level(3)) this.raw &= ~RX;
        if (!this.received.length) {
            this.raw &= ~RT;
            this.timeout.cancel();
        }
        this.updateInterrupt();
        return entry;
    }

    put(byte) {
        if (this.toSend.length >= this.depth) {
            this.complain(`${this.name}: a byte was written to a full queue`);
            return;
        }
        this.toSend.push(byte);
        if (this.toSend.length > this.level(0) || !(this.lcr & FEN)) this.raw &= ~TX;
        this.beginToSend();
        this.updateInterrupt();
    }

    beginToSend() {
        if (this.shifting !== null || !this.toSend.length || (this.cr & (UARTEN | TXE)) !== (UARTEN | TXE)) return;
        this.shifting = this.toSend.shift();
        this.isDriven = this.driver();
        // DDI 0183, 2.8.3: raised when the FIFO falls to its level, not while it stays there.
        if (this.toSend.length === (this.lcr & FEN ? this.level(0) : 0)) this.raw |= TX;
        this.sent.schedule(this.characterNanos);
    }

    endOfSent() {
        this.sent.scheduled = false;
        const byte = this.shifting;
        this.shifting = null;
        if (this.cr & LBE) this.endOfCharacter(byte);
        else if (this.isDriven && this.driver()) this.send(byte);
        else this.complain(`${this.name}: byte ${byte} was sent while the line's driver was off`);
        this.beginToSend();
        this.updateInterrupt();
    }

    readUint32(offset) {
        switch (offset) {
            case DR:
                return this.takeReceived();
            case RSR:
                return this.rsr;
            case FR:
                return (
                    (this.toSend.length ? 0 : TXFE) |
                    (this.toSend.length >= this.depth ? TXFF : 0) |
                    (this.received.length ? 0 : RXFE) |
                    (this.received.length >= this.depth ? RXFF : 0) |
                    (this.shifting !== null || this.toSend.length ? BUSY : 0)
                );
            case IBRD:
                return this.ibrd;
            case FBRD:
                return this.fbrd;
            case LCR_H:
                return this.lcr;
            case CR:
                return this.cr;
            case IFLS:
                return this.ifls;
            case IMSC:
                return this.imsc;
            case RIS:
                return this.raw;
            case MIS:
                return this.raw & this.imsc;
            case ICR:
                return 0;
            case DMACR:
                return this.dmacr;
            default:
                return super.readUint32(offset);
        }
    }

    writeUint32(offset, value) {
        switch (offset) {
            case DR:
                this.put(value & 0xff);
                break;
            case RSR:
                this.rsr = 0;
                break;
            case IBRD:
                this.ibrd = value & 0xffff;
                break;
            case FBRD:
                this.fbrd = value & 0x3f;
                break;
            case LCR_H:
                if (value & BRK) this.complain(`${this.name}: a break is not modelled`);
                this.lcr = value & 0xff;
                break;
            case CR:
                this.cr = value & 0xffff;
                this.beginToSend();
                break;
            case IFLS:
                this.ifls = value & 0x3f;
                break;
            case IMSC:
                this.imsc = value & 0x7ff;
                break;
            case ICR:
                this.raw &= ~this.rawWriteValue;
                break;
            case DMACR:
                this.dmacr = value & 7;
                break;
            default:
                super.writeUint32(offset, value);
        }
        this.updateInterrupt();
    }

    clkPeriChanged() {}
}

module.exports = { Pl011 };
