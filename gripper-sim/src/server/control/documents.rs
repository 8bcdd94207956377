//! Device files for engineering tools of PLCs, as the gripper's own web interface offers them (fieldbus, 2.1 and 3.1).

/// The path of each file, which is also its name, and its text.
pub(super) const DOCUMENTS: [(&str, &str); 2] = [
    ("/WSGB5555.gsd", include_str!("../../../../docs/WSGB5555.gsd")),
    (
        "/GSDML-V2.31-wsg-sim-WSG-20261124.xml",
        include_str!("../../../../docs/GSDML-V2.31-wsg-sim-WSG-20261124.xml"),
    ),
];
