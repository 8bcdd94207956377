//! Names of the device descriptions for PLC engineering tools, and of their bitmaps (fieldbus, 2.1 and 3.1).

/// The bridge's GSD file in `docs`.
pub const GSD: &str = "WSGB5555.gsd";

/// Its bitmaps without `.bmp`, per the manual: normal operation, diagnosis, special operating modes.
pub const GSD_BITMAPS: [&str; 3] = ["WSG_R", "WSG_D", "WSG_S"];

/// The virtual gripper's GSDML file in `docs`: schema version, vendor, family, date. Engineering tools ignore a
/// changed file of the same name, so each change requires a new date.
pub const GSDML: &str = "GSDML-V2.31-wsg-sim-WSG-20261124.xml";

/// Its bitmap without `.bmp`: vendor and device number, and family.
pub const GSDML_BITMAP: &str = "GSDML-02A2-0001-WSG";

/// Vendor in the catalogue path of both files, after Drives and I/O as in the manual. It owns the vendor number and
/// the ident number.
pub const VENDOR: &str = "Weiss Robotics GmbH & Co. KG";

/// The EDS file in `docs` of the virtual gripper and the gateway on EtherNet/IP.
pub const ETHERNETIP_EDS: &str = "wsg-ethernetip.eds";

/// The folders with a GSD and a GSDML file: for readers, and for the page of `wsg-sim`.
pub const FOLDERS: [&str; 2] = ["docs", "gripper-sim/src/server/control/device_files"];
