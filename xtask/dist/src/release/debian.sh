# Packs wsg and wsg-sim as a Debian package, into the current folder, which must be empty. The environment contains:
# FILES       folder with the content of the archive for Linux
# DOCS        folder of the documents
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
for page in gcl models simulator tool; do
    install -D -m 644 -t $doc/docs "$DOCS/$page.md"
done
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
Installed-Size: $(find tree/usr -type f -printf '%s\n' | awk '{ size += int(($1 + 1023) / 1024) } END { print size }')
Recommends: ca-certificates
Section: electronics
Priority: optional
Homepage: $HOMEPAGE
Description: command-line tool and simulator for WSG grippers
 wsg commands servo grippers of the series WSG and sets up their fieldbus
 bridge. wsg-sim is a virtual gripper.
END
(cd tree && find usr -type f | LC_ALL=C sort | xargs md5sum > DEBIAN/md5sums)
# With several threads, xz's output depends on the computer.
DPKG_DEB_THREADS_MAX=1 dpkg-deb --root-owner-group -Zxz --build tree .
