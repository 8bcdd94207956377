// Model of a Pico's QSPI flash (2 MiB, W25Q16JV), of its image, and of the boot ROM's flash functions (RP2040 data
// sheet, 2.8).
//
// Raspberry Pi's boot ROM is not used. Its functions are breakpoints that this model handles. Accesses that real
// flash would ignore or that would crash the program end the machine.
"use strict";

const fs = require("node:fs");

const LEN = 2 << 20;
const SECTOR = 4096;
const PAGE = 256;
const XIP = 0x10000000;

// W25Q16JV, 9.6: typical durations of a sector erase and a page program.
const ERASE_NANOS = 45e6;
const PROGRAM_NANOS = 0.4e6;

// W25Q16JV, 8.2.29: Read Unique ID, the offset of the number in its answer, and an example number.
const READ_UNIQUE_ID = 0x4b;
const UNIQUE_ID_AT = 5;
const UNIQUE_ID = [0xe6, 0x60, 0x58, 0x38, 0x83, 0x2a, 0x47, 0x2f];

// Registers of the interface (4.10.13) and of the chip select pin (2.19.6.2), which can be driven low.
const SSI = 0x18000, SSIENR = 0x08, SR = 0x28, DR0 = 0x60;
const TFNF = 1 << 1, RFNE = 1 << 3, FIFO_LEN = 16;
const IO_QSPI = 0x40018, SS_CTRL = 0x0c, DRIVEN_LOW = 2;

// Locations of the tables and breakpoints in the ROM.
const FUNCTIONS = 0x100;
const DATA = 0x180;
const STUBS = 0x200;
const STUB_LEN = 4;

// `lookup` comes first, because the ROM stores its address outside the table.
const CODES = ["lookup", "IF", "EX", "RE", "RP", "FC", "CX"];

class Flash {
    // `file` stores the flash; with null it is volatile.
    constructor(image, file, fail) {
        this.bytes = new Uint8Array(LEN).fill(0xff);
        this.fail = fail;
        // Number of pages or sectors until the power fails; null for never.
        this.cut = null;
        // Whether half of the last operation takes effect.
        this.isTorn = false;
        this.file = file;
        if (file && fs.existsSync(file)) this.bytes.set(fs.readFileSync(file).subarray(0, LEN));
        for (const { address, bytes } of segments(image)) {
            if (address < XIP || address + bytes.length > XIP + LEN) {
                throw new Error(`the image has ${bytes.length} bytes at 0x${address.toString(16)}, outside the flash`);
            }
            this.bytes.set(bytes, address - XIP);
        }
        const sum = crc(this.bytes.subarray(0, 252));
        const told = new DataView(this.bytes.buffer).getUint32(252, true);
        // 2.8.1.3.1
        if (sum !== told) throw new Error("the boot ROM would reject the image: wrong checksum of the second stage");
        if (file) fs.writeFileSync(file, this.bytes);
    }

    // Installs this flash and ROM in a machine.
    install(rp2040) {
        this.rp2040 = rp2040;
        this.isMapped = true;
        this.nanos = 0;
        rp2040.flash.set(this.bytes);
        const rom = new DataView(rp2040.bootrom.buffer);
        rom.setUint32(0x10, 0x0301754d, true);
        rom.setUint16(0x14, FUNCTIONS, true);
        rom.setUint16(0x16, DATA, true);
        rom.setUint16(0x18, STUBS | 1, true);
        CODES.forEach((_, n) => rom.setUint32(STUBS + n * STUB_LEN, 0x4770be00 | n, true));
        rp2040.onBreak = (code) => {
            if (rp2040.core.PC >= 0x4000) this.fail(`breakpoint ${code} at ${hex(rp2040.core.PC)}`);
            else this.call(CODES[code], rp2040.core.registers);
        };
        this.connectInterface(rp2040.peripherals[SSI], rp2040.peripherals[IO_QSPI]);
    }

    // While the flash is not mapped, bytes are exchanged with the chip one by one.
    connectInterface(ssi, pins) {
        this.isSelected = false;
        let asked = [], answers = [];
        const [read, write] = [ssi.readUint32.bind(ssi), ssi.writeUint32.bind(ssi)];
        ssi.readUint32 = (offset) => {
            if (this.isMapped || ![SR, DR0].includes(offset)) return read(offset);
            return offset === SR ? TFNF | (answers.length ? RFNE : 0) : (answers.shift() ?? 0);
        };
        ssi.writeUint32 = (offset, value) => {
            // The second stage maps the flash by enabling the interface.
            if (offset === SSIENR && value === 1) this.isMapped = true;
            if (this.isMapped || offset !== DR0) return write(offset, value);
            if (!this.isSelected || answers.length === FIFO_LEN) return this.fail(`the byte ${hex(value)} to the flash is lost`);
            const at = asked.push(value) - 1 - UNIQUE_ID_AT;
            answers.push(asked[0] === READ_UNIQUE_ID && at >= 0 ? UNIQUE_ID[at % UNIQUE_ID.length] : 0xff);
        };
        pins.writeUint32 = (offset, value) => {
            if (offset !== SS_CTRL) return;
            this.isSelected = ((value >> 8) & 3) === DRIVEN_LOW;
            [asked, answers] = [[], []];
        };
    }

    // Returns the duration of the last ROM function.
    takeNanos() {
        const { nanos } = this;
        this.nanos = 0;
        return nanos;
    }

    call(code, registers) {
        const [first, second, third] = registers;
        switch (code) {
            case "lookup": {
                const wanted = String.fromCharCode(second & 0xff, (second >> 8) & 0xff);
                const n = first === FUNCTIONS ? CODES.indexOf(wanted) : -1;
                registers[0] = n > 0 ? (STUBS + n * STUB_LEN) | 1 : 0;
                if (n < 0) this.fail(`the boot ROM's ${wanted} is not modelled`);
                break;
            }
            case "IF":
            case "EX":
                this.isMapped = false;
                break;
            case "CX":
                this.isMapped = true;
                break;
            case "FC":
                // Also returns the chip select pin to the interface.
                this.isSelected = false;
                break;
            case "RE":
                this.erase(first, second);
                break;
            case "RP":
                this.program(first, second, third);
                break;
        }
    }

    erase(at, len) {
        if (!this.may("erase", at, len, SECTOR)) return;
        for (let sector = at; sector < at + len; sector += SECTOR) {
            const len = this.begin(ERASE_NANOS, SECTOR);
            this.rp2040.flash.fill(0xff, sector, sector + len);
            this.keep(sector, len);
            if (len < SECTOR) return;
        }
    }

    program(at, from, len) {
        if (!this.may("program", at, len, PAGE)) return;
        for (let page = at; page < at + len; page += PAGE) {
            const len = this.begin(PROGRAM_NANOS, PAGE);
            for (let n = 0; n < len; n++) {
                // Programming clears bits; only an erase sets them.
                this.rp2040.flash[page + n] &= this.rp2040.readUint8(from + page - at + n);
            }
            this.keep(page, len);
            if (len < PAGE) return;
        }
    }

    may(what, at, len, unit) {
        if (this.isMapped) this.fail(`${what} at ${hex(at)} while the flash is mapped`);
        else if (at % unit || len % unit || at + len > LEN) this.fail(`${what} of ${len} bytes at ${hex(at)}`);
        else return true;
        return false;
    }

    // Returns how many bytes of an operation take effect: all, as long as the power lasts.
    begin(nanos, len) {
        if (this.cut !== null && this.cut-- <= 0) {
            this.fail("the power was cut");
            return this.isTorn && this.cut === -1 ? len / 2 : 0;
        }
        this.nanos += nanos;
        return len;
    }

    keep(at, len) {
        const bytes = this.rp2040.flash.subarray(at, at + len);
        this.bytes.set(bytes, at);
        if (!this.file) return;
        const file = fs.openSync(this.file, "r+");
        fs.writeSync(file, bytes, 0, len, at);
        fs.closeSync(file);
    }
}

// Returns the loaded segments of an ELF file by storage address.
function segments(elf) {
    if (elf.readUInt32BE(0) !== 0x7f454c46 || elf[4] !== 1) throw new Error("not a 32-bit ELF file");
    const [table, size, count] = [elf.readUInt32LE(28), elf.readUInt16LE(42), elf.readUInt16LE(44)];
    const found = [];
    for (let n = 0; n < count; n++) {
        const [type, at, , address, len] = [0, 4, 8, 12, 16].map((field) => elf.readUInt32LE(table + n * size + field));
        if (type === 1 && len) found.push({ address, bytes: elf.subarray(at, at + len) });
    }
    return found;
}

// CRC-32 of the boot ROM: not reflected, no final inversion.
function crc(bytes) {
    let sum = 0xffffffff;
    for (const byte of bytes) {
        sum ^= byte << 24;
        for (let bit = 0; bit < 8; bit++) sum = sum & 0x80000000 ? (sum << 1) ^ 0x04c11db7 : sum << 1;
    }
    return sum >>> 0;
}

function hex(address) {
    return `0x${(address >>> 0).toString(16).padStart(8, "0")}`;
}

module.exports = { Flash, hex };
