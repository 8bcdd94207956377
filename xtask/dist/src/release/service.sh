# Tries the gateway's service under systemd, as process 1 of namespaces of its own. The environment contains:
# PACKAGE    folder in which the Debian package is installed. Its files cover the system's
# ROOM       folder to work in
# PROCESS_1  systemd, or another program to find out whether this machine permits namespaces, overlayfs and cgroup2
# It requires root, and a mount namespace (unshare --mount).
set -eux

start() {
    mount -t tmpfs none "$ROOM"
    cd "$ROOM"
    mkdir cgroup log root upper work
    cp -a "$PACKAGE" package
    cp "$0" package/service.sh
    cat > package/usr/lib/systemd/system/trial.service << 'END'
[Unit]
Requires=systemd-journald.service
After=systemd-journald.service
[Service]
ExecStart=/bin/bash /service.sh try_service
ExecStopPost=/bin/systemctl --no-block exit $EXIT_STATUS
StandardOutput=file:/mnt/log
StandardError=file:/mnt/log
END
    # Process 1 takes the group of its start for the root of its groups.
    mount -t cgroup2 none cgroup
    group=cgroup/wsg-service-$$
    mkdir $group
    status=0
    bash -c 'echo $$ > "$0/cgroup.procs"; exec timeout 180 unshare "$@"' $group --fork --kill-child --pid --mount --cgroup --net \
        --uts --ipc bash "$0" process_1 || status=$?
    cat log/log || true
    find $group -depth -type d -exec rmdir {} +
    exit $status
}

# With the package and its changes over the system's files.
process_1() {
    cd "$ROOM"
    mount -t overlay -o lowerdir=package:/,upperdir=upper,workdir=work none root
    cd root
    mount -t proc none proc
    mount --bind proc/sys proc/sys
    mount -o remount,bind,ro proc/sys
    mount -t sysfs -o ro none sys
    mount -t cgroup2 none sys/fs/cgroup
    for folder in dev run tmp; do mount -t tmpfs none $folder; done
    mkdir dev/pts dev/shm run/host
    mknod -m 666 dev/null c 1 3
    mknod -m 666 dev/urandom c 1 9
    mount --bind ../log mnt
    pivot_root . run/host
    umount --lazy run/host
    exec env --ignore-environment PATH=/usr/sbin:/usr/bin:/sbin:/bin container=wsg "$PROCESS_1" --unit=trial.service
}

value() { systemctl show --value --property "$1" wsg-gateway; }
messages() { journalctl --sync; journalctl --output cat --unit wsg-gateway "$@"; }
runs_again() { [ "$(value NRestarts)" = "$1" ] && [ "$(value ActiveState)" = active ] && connected; }
connected() { wsg gateway status 127.0.0.1 | grep 'connected: WSG'; }
within_30_s() { for _ in {1..300}; do if "$@"; then return; fi; sleep 0.1; done; return 1; }
flags() { wsg gripper tcp://127.0.0.1 flags; }
# Writes flags, 20 mm, 20 mm/s and 40 N, and expects the answer.
write() {
    printf "\0\1\0\0\0\17\1\20\0\0\0\4\10$1\0\7\320\7\320\17\240" >&3
    [ "$(head --bytes 12 <&3 | od -A n -t x1)" = ' 00 01 00 00 00 06 01 10 00 00 00 04' ]
    sleep 0.1
}

# A service of this systemd.
try_service() {
    wsg-sim --tcp 127.0.0.1:1000 --homing-at-start --homing-speed 400 &
    ip link add eth0 type veth peer eth1
    ip link set eth0 up

    # The delivered configuration has no gripper: one error, and no restart.
    (! systemctl start wsg-gateway)
    sleep 4
    [ "$(value ActiveState) $(value NRestarts)" = 'failed 0' ]
    [ "$(messages --priority err --grep 'gateway.toml: no gripper' | wc --lines)" = 1 ]

    cat > /etc/wsg/gateway.toml << 'END'
[[gripper]]
gripper = "tcp://127.0.0.1"
modbus = "127.0.0.1:502"
profinet = "eth0"
settings = "/var/lib/wsg/settings"
delivered.BUS_TIMEOUT = 60000
END
    systemctl start wsg-gateway
    within_30_s connected
    process=$(value MainPID)
    [ "$(stat --format %U "/proc/$process")" = wsg-gateway ]
    chrt --pid "$process" | grep SCHED_RR
    wsg bridge tcp://127.0.0.1 set SWAP_BYTES 0 --save
    [ -s /var/lib/wsg/settings ]
    sleep 5
    [ "$(value NRestarts)" = 0 ]

    # The watchdog, and the end of the process.
    kill -STOP "$process"
    within_30_s runs_again 1
    flags | grep FAST_STOP
    kill -KILL "$(value MainPID)"
    within_30_s runs_again 2

    # The regular end during a motion. STOP/ACK, then MOVE.
    exec 3<> /dev/tcp/127.0.0.1/502
    for flags in '\0' '\20' '\0' '\1'; do write "$flags"; done
    wsg gateway status 127.0.0.1 | grep MOVING
    systemctl stop wsg-gateway
    (! flags | grep -e FAST_STOP -e MOVING)
    (! wsg gripper tcp://127.0.0.1 width | grep 'width 20')
    messages --priority info --grep 'connected to'
    (! messages --priority warning --grep 'connected to')
}

"${1:-start}"
