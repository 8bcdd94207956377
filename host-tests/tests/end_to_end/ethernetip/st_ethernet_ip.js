// The steps are as in cycle.py.
const assert = require("node:assert");
const { IO } = require("st-ethernet-ip");

// It sends outputs only in answer to inputs.
const scanner = new IO.Scanner(2222, "127.0.0.1");
const connection = scanner.addConnection({
    configInstance: { assembly: 151, size: 0 },
    inputInstance: { assembly: 100, size: 12 },
    outputInstance: { assembly: 150, size: 8 },
}, 100, "127.0.0.2");

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

async function run() {
    for (const step of process.argv.slice(1)) {
        const [outputs, mask, expected] = step.split(" ").map((hex) => Buffer.from(hex, "hex"));
        const end = Date.now() + 60_000;
        const isReached = () => mask.map((byte, at) => byte & connection.inputData[at]).equals(expected);
        // Again after a time-out of the connection on a busy machine: a flag that is set in the first outputs is no edge.
        for (let tries = 0; !isReached(); tries += 1) {
            assert(Date.now() < end, `${step}: ${connection.inputData.toString("hex")}`);
            connection.outputData.fill(0);
            await pause(tries === 0 ? 0 : 1_000);
            outputs.copy(connection.outputData);
            for (const again = Date.now() + 10_000; !isReached() && Date.now() < again;) {
                await pause(10);
            }
        }
    }
    console.log("cycle done");
}

run().then(() => process.exit(0), (error) => {
    console.error(error);
    process.exit(1);
});
