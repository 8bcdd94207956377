//! Compares the mapping with a naive reader of the whole capture, for every loss pattern of three messages, and tests
//! edge cases one by one.

use core::iter;
use std::vec;
use std::vec::Vec;

use embedded_can::{ExtendedId, Id, StandardId};
use proptest::prelude::*;

use super::*;
use crate::frame::OVERHEAD;
use crate::{Command, CommandId, Event, FrameEncoder, Instant, Kind, Reply, Status, checksum};

mod bus;
mod capture;
mod loss_patterns;
mod one_by_one;

use bus::{CanFrame, HALF_MS, Message, RECEIVED, Seen, Wire};
