use super::*;

const DATA: Submodule = Submodule { subslot: 1, ident: 1, input_len: 3, output_len: 2 };

/// A valid profile for 2 bytes of outputs and 3 of inputs, at all its limits.
const LARGEST: Profile = Profile {
    vendor_id: 1,
    device_id: 1,
    station_type: "a name of 25 letters, yes",
    order_id: "a number of 20 signs",
    serial_number: "a number with 16",
    hardware_revision: 1,
    software_revision: [1, 0, 0],
    min_interval: 32,
    modules: &[
        Module { slot: 0, ident: 1, name: "", submodules: &[EMPTY; MAX_SUBMODULES - 1] },
        Module { slot: 1, ident: 1, name: "", submodules: &[DATA] },
    ],
    faults: &[FAULT; 32],
};
const EMPTY: Submodule = Submodule { subslot: 1, ident: 1, input_len: 0, output_len: 0 };
const FAULT: Fault = Fault { error_type: 0x0100, name: "", priority: Priority::Low };

#[test]
fn profile_at_its_limits_fits_only_its_own_data() {
    assert!(LARGEST.fits(2, 3));
    for (outputs, inputs) in [(1, 3), (3, 3), (2, 2), (2, 4), (3, 2), (0, 0)] {
        assert!(!LARGEST.fits(outputs, inputs), "{outputs} {inputs}");
    }
    assert!(Profile { min_interval: 16_384, ..LARGEST }.fits(2, 3));
    assert!(Profile { modules: &[], ..LARGEST }.fits(0, 0));
}

#[test]
fn profile_beyond_a_limit_fits_nothing() {
    for (what, profile) in [
        ("station type", Profile { station_type: "a name of 26 letters, yes.", ..LARGEST }),
        ("order", Profile { order_id: "a number of 21 signs.", ..LARGEST }),
        ("serial number", Profile { serial_number: "a number with 16.", ..LARGEST }),
        ("interval, half", Profile { min_interval: 16, ..LARGEST }),
        ("interval, odd", Profile { min_interval: 48, ..LARGEST }),
        ("faults", Profile { faults: &[FAULT; 33], ..LARGEST }),
        (
            "submodules",
            Profile {
                modules: &[
                    Module { slot: 0, ident: 1, name: "", submodules: &[EMPTY; MAX_SUBMODULES] },
                    Module { slot: 1, ident: 1, name: "", submodules: &[DATA] },
                ],
                ..LARGEST
            },
        ),
    ] {
        assert!(!profile.fits(2, 3), "{what}");
    }
}

#[test]
fn provider_status_accompanies_data_and_consumer_status_returns() {
    for ((input_len, output_len), lens) in
        [((3, 2), (5, 4)), ((12, 0), (13, 1)), ((0, 8), (1, 9)), ((0, 0), (1, 1))]
    {
        let submodule = Submodule { input_len, output_len, ..EMPTY };
        assert_eq!(submodule.frame_lens(), lens, "{input_len} bytes in, {output_len} bytes out");
    }
}
