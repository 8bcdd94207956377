# Packs wsg and wsg-sim as a Debian package, into the current folder, which must be empty. The environment contains:
# FILES       folder with the content of the archive for Linux
# DOCS        folder of the documents
# SERVICE     folder of the gateway's service
# VERSION     version of the programs
# CPU         processor, as dpkg names it
# MAINTAINER  name and address
# HOMEPAGE    address of the repository
# SOURCE_DATE_EPOCH
set -eu
umask 022

share=tree/usr/share
doc=$share/doc/wsg-tools
install -D -t tree/usr/bin "$FILES/wsg" "$FILES/wsg-sim"
install -D -m 644 -t $share/man/man1 "$FILES"/man/*.1
install -D -m 644 -t $share/fish/vendor_completions.d "$FILES"/completions/*.fish
install -D -m 644 -t $share/zsh/vendor-completions "$FILES"/completions/_*
for program in wsg wsg-sim; do
    install -D -m 644 "$FILES/completions/$program.bash" $share/bash-completion/completions/$program
done
install -D -m 644 "$FILES/LICENCES.txt" $doc/copyright
install -D -m 644 "$FILES/CHANGELOG.md" $doc/changelog
# The help and the manual pages refer to these.
for page in ethernetip gateway gcl models registers simulator tool; do
    install -D -m 644 -t $doc/docs "$DOCS/$page.md"
done
install -D -m 644 -t tree/usr/lib/systemd/system "$SERVICE/wsg-gateway.service"
install -D -m 644 -t tree/etc/wsg "$SERVICE/gateway.toml"
cat > $doc/changelog.Debian << END
wsg-tools ($VERSION-1) unstable; urgency=medium

  * Release $VERSION. changelog.gz lists its changes.

 -- $MAINTAINER  $(date -u -R -d "@$SOURCE_DATE_EPOCH")
END
gzip -9n $share/man/man1/* $doc/changelog*

# The programs are static and depend on nothing. Telemetry over TLS reads the system's certificates.
mkdir tree/DEBIAN
cat > tree/DEBIAN/control << END
Package: wsg-tools
Version: $VERSION-1
Architecture: $CPU
Maintainer: $MAINTAINER
Installed-Size: $(find tree/etc tree/usr -type f -printf '%s\n' | awk '{ size += int(($1 + 1023) / 1024) } END { print size }')
Recommends: ca-certificates
Section: electronics
Priority: optional
Homepage: $HOMEPAGE
Description: command-line tool and simulator for WSG grippers
 wsg commands servo grippers of the series WSG and sets up their fieldbus
 bridge. wsg-sim is a virtual gripper. The service wsg-gateway connects PLCs
 to grippers; enable it after editing /etc/wsg/gateway.toml.
END
echo /etc/wsg/gateway.toml > tree/DEBIAN/conffiles
# As debhelper does for a service that is neither enabled nor restarted: an update must not stop the fingers.
cat > tree/DEBIAN/postinst << 'END'
#!/bin/sh
set -e
deb-systemd-helper update-state wsg-gateway.service > /dev/null || true
if [ -z "${DPKG_ROOT:-}" ] && [ -d /run/systemd/system ]; then
    systemctl --system daemon-reload > /dev/null || true
fi
END
cat > tree/DEBIAN/prerm << 'END'
#!/bin/sh
set -e
if [ -z "${DPKG_ROOT:-}" ] && [ "$1" = remove ] && [ -d /run/systemd/system ]; then
    deb-systemd-invoke stop wsg-gateway.service > /dev/null || true
fi
END
cat > tree/DEBIAN/postrm << 'END'
#!/bin/sh
set -e
if [ "$1" = purge ]; then
    deb-systemd-helper purge wsg-gateway.service > /dev/null || true
    rm -rf "${DPKG_ROOT:-}/var/lib/wsg" "${DPKG_ROOT:-}/var/lib/private/wsg"
elif [ -z "${DPKG_ROOT:-}" ] && [ "$1" = remove ] && [ -d /run/systemd/system ]; then
    systemctl --system daemon-reload > /dev/null || true
fi
END
chmod 755 tree/DEBIAN/postinst tree/DEBIAN/prerm tree/DEBIAN/postrm
(cd tree && find usr -type f | LC_ALL=C sort | xargs md5sum > DEBIAN/md5sums)
# With several threads, xz's output depends on the computer.
DPKG_DEB_THREADS_MAX=1 dpkg-deb --root-owner-group -Zxz --build tree .
