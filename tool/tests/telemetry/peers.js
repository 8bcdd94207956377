// Sparkplug B with Eclipse Tahu's library: decodes lines of "TOPIC HEX" to lines of JSON, or encodes a JSON argument to hex.
const { decodePayload, encodePayload } = require("sparkplug-payload").get("spBv1.0");
const { createInterface } = require("readline");

const plain = (_, value) => (value && value.low !== undefined && value.high !== undefined ? Number(value.toString()) : value);

if (process.argv[2]) {
  process.stdout.write(Buffer.from(encodePayload(JSON.parse(process.argv[2]))).toString("hex"));
} else {
  createInterface({ input: process.stdin }).on("line", (line) => {
    const [topic, hex] = line.split(" ");
    let payload = {};
    try {
      payload = topic.startsWith("spBv1.0/") ? decodePayload(Buffer.from(hex ?? "", "hex")) : {};
    } catch (error) {
      payload = { error: String(error) };
    }
    console.log(JSON.stringify({ topic, ...payload }, plain));
  });
}
