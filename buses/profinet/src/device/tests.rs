//! Behaviour of the device, as seen by a controller.

mod alarms;
mod connect;
pub(crate) mod controller;
mod cyclic;
mod discovery;
mod records;

use super::*;
use crate::Maintenance;
use controller::*;
use std::string::String;
use std::vec;
use std::vec::Vec;
