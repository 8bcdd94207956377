// Connects SPI0 to a chip model in another process, one byte at a time, in machine time.
//
// To the model, 10 bytes: machine time in nanoseconds (64 bits, little endian), event, byte. From it, 10 bytes: byte,
// level of its interrupt line, and latest time of its next event (64 bits).
"use strict";

const fs = require("node:fs");

const TIME_PASSES = 0, SELECTED = 1, BYTE = 2, DESELECTED = 3, RESET = 4;

class SpiToModel {
    constructor() {
        this.question = Buffer.alloc(10);
        this.answer = Buffer.alloc(10);
    }

    connect(rp2040, spi, { isSelected, setInterrupt, fail }) {
        Object.assign(this, { clock: rp2040.clock, isSelected, setInterrupt, fail });
        this.wasSelected = false;
        this.next = this.clock.createAlarm(() => this.ask(TIME_PASSES));
        let byte = 0;
        const sent = this.clock.createAlarm(() => spi.completeTransmit(this.isSelected() ? this.ask(BYTE, byte) : 0xff));
        spi.onTransmit = (value) => {
            // The chip's two modes have equal clock polarity and phase.
            const mode = (spi.control0 >> 6) & 3;
            if (spi.dataBits !== 8 || mode === 1 || mode === 2) fail(`SPI0: ${spi.dataBits} bits, SPO and SPH ${mode}`);
            if (spi.clockFrequency > 10e6) fail(`SPI0: ${spi.clockFrequency} Hz, the MCP2515 supports up to 10 MHz`);
            byte = value;
            sent.schedule(8e9 / spi.clockFrequency);
        };
        this.ask(RESET);
    }

    // Checks the select line for a change.
    look() {
        if (this.isSelected() === this.wasSelected) return;
        this.wasSelected = !this.wasSelected;
        this.ask(this.wasSelected ? SELECTED : DESELECTED);
    }

    ask(what, byte = 0) {
        const { question, answer, clock } = this;
        question.writeBigUInt64LE(BigInt(Math.floor(clock.nanos)), 0);
        question[8] = what;
        question[9] = byte;
        fs.writeSync(1, question);
        for (let at = 0; at < answer.length; ) {
            const read = fs.readSync(0, answer, at, answer.length - at);
            if (read === 0) process.exit();
            at += read;
        }
        this.setInterrupt(answer[1] !== 0);
        const nanos = Number(answer.readBigUInt64LE(2)) - clock.nanos;
        this.next.schedule(Math.max(nanos, 1000));
        return answer[0];
    }
}

module.exports = { SpiToModel };
