//! Device files for engineering tools of PLCs: their names, and those of the bitmaps beside them (fieldbus, 2.1 and 3.1).

/// The GSD file of the bridge, in `docs`.
pub const GSD: &str = "WSGB5555.gsd";

/// Its bitmaps without `.bmp`, as the manual names them: normal operation, diagnosis, special operating modes.
pub const GSD_BITMAPS: [&str; 3] = ["WSG_R", "WSG_D", "WSG_S"];

/// The GSDML file of the virtual gripper, in `docs`: version of the schema, maker, family, date. Engineering tools ignore changes of a
/// file that they have under the same name, so each change needs another date.
pub const GSDML: &str = "GSDML-V2.31-wsg-sim-WSG-20261124.xml";

/// Its bitmap without `.bmp`: vendor and device number, and the family.
pub const GSDML_BITMAP: &str = "GSDML-02A2-0001-WSG";

/// Where both files have engineering tools list the device, after Drives and after I/O: at the manual's path, with the vendor to whom
/// the vendor number and the ident number belong.
pub const VENDOR: &str = "Weiss Robotics GmbH & Co. KG";
