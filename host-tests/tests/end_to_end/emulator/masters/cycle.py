# The common part of all Python masters. Each test prepends read(address, count), inputs(address, count),
# write(address, values) and coil(address, value).

import time

def wait(done, seconds=60):
    end = time.time() + seconds
    while time.time() < end:
        image = inputs(0, 6)
        if done(image):
            return image
    raise SystemExit("time-out; input image %r" % (image,))

def command(flags, width=0, speed=0, force=0):
    write(0, [flags << 8, width, speed, force])
    write(0, [0, width, speed, force])
    return wait(lambda image: image[5] != 26)

wait(lambda image: image[0] >> 8 != 0)
write(0, [0, 0, 0, 0])
command(1 << 4)                                      # STOP/ACK: the FAST STOP of power-up
image = command(1 << 3)                              # HOMING
assert (image[0] >> 8, image[5]) == (1, 0), image    # IDLE, E_SUCCESS
assert image[1] & 0x0100, image                      # REFERENCED
image = command(1 << 1, 2000, 5000, 4000)            # GRIP
assert (image[0] >> 8, image[5]) == (1 << 4, 0), image
image = wait(lambda image: abs(image[3] - 2000) < 60 and abs(image[4] - 4000) < 200)
assert read(0, 4) == [0, 2000, 5000, 4000], read(0, 4)
write(0, [0, 4000, 5000, 4000])
coil(2, True)                                        # RELEASE
coil(2, False)
image = wait(lambda image: image[5] != 26)
assert (image[0] >> 8, image[5]) == (1, 0), image
print("cycle done")
