//! The virtual gripper on PROFIBUS with a third-party master, and the GSD file in this master's parser.

use document::root;
use host_tests::masters::{self, printed};
use wsg_fieldbus::Diagnosis;
use wsg_fieldbus::profibus::PROFILE;
use wsg_sim::server::{Lines, SerialLine, ServerThread};
use wsg_sim::{Config, Part};

#[test]
#[ignore = "needs pyprofibus: run `cargo xtask test`"]
fn pyprofibus_runs_a_grip_cycle_on_the_virtual_gripper() {
    let config = Config { time_scale: 10.0, part: Part::of_width(20.0), ..Config::default() };
    let lines = Lines { profibus: Some(SerialLine::Pty), ..Lines::default() };
    let server = ServerThread::start(config, &lines, None).unwrap();
    let arguments = [server.profibus_path().unwrap().to_str().unwrap(), &gsd_file()];
    let output = masters::python(include_str!("pyprofibus.py"), &arguments);
    assert!(output.status.success(), "{}", printed(&output));
}

/// Prints facts of a GSD file, and the resulting parameter and configuration bytes.
const PRINT_GSD: &str = "
import sys
from pyprofibus.gsd.interp import GsdInterp
gsd = GsdInterp.fromFile(sys.argv[1])
names = ['Max_Diag_Data_Len', 'Freeze_Mode_supp', 'Sync_Mode_supp', 'Set_Slave_Add_supp', 'Fail_Safe', 'Auto_Baud_supp']
print(gsd.getIdentNumber(), *(int(gsd.getField(name)) for name in names), len(gsd.getUserPrmData()))
print(*(byte for element in gsd.getCfgDataElements() for byte in element.getDU()))
";

#[test]
#[ignore = "needs pyprofibus: run `cargo xtask test`"]
fn parser_of_pyprofibus_reads_what_the_tables_say() {
    let output = masters::python(PRINT_GSD, &[&gsd_file()]);
    let lines: Vec<Vec<usize>> = String::from_utf8_lossy(&output.stdout)
        .lines()
        .map(|line| line.split(' ').map(|number| number.parse().unwrap()).collect())
        .collect();
    let flags = [PROFILE.freeze, PROFILE.sync, PROFILE.set_address, PROFILE.fail_safe, true].map(usize::from);
    let facts = [&[usize::from(PROFILE.ident), Diagnosis::LEN], &flags[..], &[0]].concat();
    let config = PROFILE.config.iter().map(|byte| usize::from(*byte)).collect();
    assert_eq!(lines, [facts, config], "{}", printed(&output));
}

/// Returns the GSD file's path.
pub(crate) fn gsd_file() -> String {
    root().join("docs/WSGB5555.gsd").to_str().unwrap().to_owned()
}
