import subprocess
import sys
import time


def run(program, *arguments):
    command = [sys.executable, "-m", f"cpppo.server.enip.{program}", "-a", "127.0.0.2:44818", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done
    return done.stdout


listed = run("list_services", "--list-identity")
assert "'WSG'" in listed and "'Communications'" in listed, listed
# Without routing. It prints bytes in decimal. A gateway may not have connected to its gripper yet.
end = time.time() + 60
while "@0x0004/100/3 == [1, 0, " not in (read := run("get_attribute", "-S", "@4/100/3", "@1/1/7")):
    assert time.time() < end, read
assert "@0x0001/1/7 == [3, 87, 83, 71]" in read, read
print("passed")
