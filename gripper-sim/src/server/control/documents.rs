//! Device files for engineering tools of PLCs, as the gripper's own web interface offers them (fieldbus, 2.1 and 3.1). Packages of
//! the program contain no documents, so the files are here again, from the same tables.

/// The path of each file, which is also its name, and its text.
pub(super) const DOCUMENTS: [(&str, &str); 2] = [
    ("/WSGB5555.gsd", include_str!("device_files/WSGB5555.gsd")),
    (
        "/GSDML-V2.31-wsg-sim-WSG-20261124.xml",
        include_str!("device_files/GSDML-V2.31-wsg-sim-WSG-20261124.xml"),
    ),
];
