// jsmodbus as the master of unit 1: `tcp PORT` of the virtual gripper or a gateway, or `rtu TERMINAL` of the bridge.
const assert = require("node:assert");
const fs = require("node:fs");
const net = require("node:net");
const tty = require("node:tty");
const modbus = require("jsmodbus");

const [kind, where] = process.argv.slice(1);

async function connect() {
    if (kind === "tcp") {
        const socket = new net.Socket();
        const client = new modbus.client.TCP(socket, 1);
        await new Promise((resolve, reject) => socket.once("connect", resolve).once("error", reject).connect(where));
        return client;
    }
    const line = new tty.ReadStream(fs.openSync(where, fs.constants.O_RDWR | fs.constants.O_NOCTTY));
    // Stands in for a port of the package serialport, which has this property.
    line.isOpen = true;
    return new modbus.client.RTU(line, 1, 60_000);
}

const IDLE = 1 << 0, HOLDING = 1 << 4, ERROR = 1 << 7, PENDING = 26;

async function run(client) {
    const values = async (answer) => (await answer).response.body.valuesAsArray;
    const read = (address, count) => values(client.readHoldingRegisters(address, count));
    const refused = (request, code) => assert.rejects(request, (error) => error.response?.body.code === code);

    async function ended() {
        const end = Date.now() + 60_000;
        for (;;) {
            const image = await values(client.readInputRegisters(0, 6));
            if (image[5] !== PENDING) {
                return [image[0] >> 8, image[5]];
            }
            assert(Date.now() < end, "time-out");
        }
    }

    async function command(flags, width = 0, speed = 0, force = 0) {
        await client.writeMultipleRegisters(0, [flags << 8, width, speed, force]);
        await client.writeMultipleRegisters(0, [0, width, speed, force]);
        return ended();
    }

    await client.writeMultipleRegisters(0, [0, 0, 0, 0]);
    await command(1 << 4); // STOP/ACK: on the bridge the FAST STOP of power-up
    if (kind === "tcp") {
        assert.deepEqual(await command(1 << 0, 5000, 5000, 4000), [ERROR, 3], "MOVE is refused");
    }
    assert.deepEqual(await command(1 << 3), [IDLE, 0], "HOMING");
    assert.deepEqual(await command(1 << 1, 2000, 5000, 4000), [HOLDING, 0], "GRIP");
    assert.deepEqual([...await read(0, 4)], [0, 2000, 5000, 4000]);
    await client.writeMultipleRegisters(0, [0, 4000, 5000, 4000]);
    assert.equal((await client.writeSingleCoil(2, true)).response.body.value, true);
    await client.writeSingleCoil(2, false);
    assert.deepEqual(await ended(), [IDLE, 0], "RELEASE");

    await client.writeSingleRegister(1, 4001);
    await client.writeMultipleCoils(8, [true, false, true, false, false, false, false, true]);
    assert.deepEqual([...await read(0, 2)], [0x85, 4001]);
    const bits = async (answer, count) => [...await values(answer)].slice(0, count).map(Number);
    assert.deepEqual(await bits(client.readCoils(7, 10), 10), [0, 1, 0, 1, 0, 0, 0, 0, 1, 1]);
    assert.deepEqual(await bits(client.readDiscreteInputs(0, 2), 2), [1, 0], "IDLE");
    await refused(client.readHoldingRegisters(4, 1), 2);
    const identity = (await client.readDeviceIdentification(3, 0)).response.body;
    assert.deepEqual([identity.conformityLevel, identity.objects.map(({ id }) => id)], [0x81, [0, 1, 2]]);
    assert(identity.objects[0].value.toString().startsWith("wsg-"), "the vendor");
    if (kind === "tcp") {
        // On a serial line, jsmodbus takes the checksum of this exception as part of it.
        await refused(client.readDeviceIdentification(4, 0x80), 2);
    }
    console.log("cycle done");
}

connect().then(run).then(() => process.exit(0), (error) => {
    console.error(error);
    process.exit(1);
});
