"""The steps of a grip cycle, for a scanner that starts with zeros and has `inputs()` and `set_outputs(image)`.

Each argument is a step, three images in hex: outputs, mask of inputs, inputs. The step ends when the masked inputs are equal.
"""

import sys
import time


def run(inputs, set_outputs):
    for step in sys.argv[1:]:
        outputs, mask, expected = map(bytes.fromhex, step.split())
        set_outputs(outputs)
        end = time.time() + 60
        while bytes(a & b for a, b in zip(inputs(), mask)) != expected:
            assert time.time() < end, f"outputs {outputs.hex()}: inputs {inputs().hex()}, not {expected.hex()}"
            time.sleep(0.01)


