//! Facts about the boards the bridge runs on that also concern others than the board file:
//! which wire is on which pin. Data only; registers are the board file's.

pub mod b_l475e_iot01a;
