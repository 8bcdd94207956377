# A serial line for the masters that would otherwise wait for their time-out to detect an answer that is shorter than
# expected, such as an exception: `read` ends with the answer, whose first bytes determine its length. No master repeats
# a request, so the time-out only has to exceed every pause of a busy host.
import serial

TIMEOUT = 60

class Line(serial.Serial):
    answer = b""

    def write(self, request):
        self.answer = b""
        return super().write(request)

    def read(self, size=1):
        start = len(self.answer)
        end = start + size
        while (count := min(end, length(self.answer)) - len(self.answer)) > 0:
            received = super().read(count)
            if not received:
                break
            self.answer += received
        return self.answer[start:]

def length(answer):
    if len(answer) < 3:
        return 3
    if answer[1] & 0x80:
        return 5
    return 8 if answer[1] in (5, 6, 15, 16) else 5 + answer[2]

line = Line(sys.argv[1], baudrate=19200, timeout=TIMEOUT)
