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

async function run() {
    for (const step of process.argv.slice(1)) {
        const [outputs, mask, expected] = step.split(" ").map((hex) => Buffer.from(hex, "hex"));
        outputs.copy(connection.outputData);
        const end = Date.now() + 60_000;
        while (!mask.map((byte, at) => byte & connection.inputData[at]).equals(expected)) {
            assert(Date.now() < end, `${step}: ${connection.inputData.toString("hex")}`);
            await new Promise((resolve) => setTimeout(resolve, 10));
        }
    }
    console.log("cycle done");
}

run().then(() => process.exit(0), (error) => {
    console.error(error);
    process.exit(1);
});
