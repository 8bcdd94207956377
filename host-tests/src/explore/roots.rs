//! Initial states of an exploration: power-up, and each stable state of a bridge.

use wsg_bridge_fw::io::Inputs;

use super::action::{JOG_PLUS, ZERO};
use super::plant::Plant;
use crate::operation::{GripperEvent, Operation};

#[derive(Debug)]
pub(super) struct Root {
    pub(super) name: &'static str,
    pub(super) plant: Plant,
}

/// Returns all initial states for an exploration with these actions.
pub(super) fn roots(actions: &'static [Operation]) -> Vec<Root> {
    use Operation::*;
    let has_bus = actions.contains(&FallSilent);
    let pulse = |plant: &Plant, wire| plant.after(&[Toggle(wire), AnswersAll, Toggle(wire)]);

    let switched_on = Plant::switched_on(actions);
    let connected = switched_on.after(&[AnswersAll, Toggle(Inputs::FAST_STOP_OK)]);
    let ready = pulse(&connected, Inputs::STOP_ACK);
    let ready = if has_bus { ready.after(&[Write(ZERO), AnswersAll]) } else { ready };
    let homing = pulse(&ready, Inputs::HOME);
    // BUSY goes low after its minimum time.
    let rest = [AnswersAll, Wait, AnswersAll];
    let finish = || Gripper(GripperEvent::Finishes);
    let homed = homing.after(&[finish()]).after(&rest);
    let moving = pulse(&homed, Inputs::MOVE).after(&rest);
    let preparing = homed.after(&[Toggle(Inputs::GRIP)]);
    let gripping = preparing.after(&rest);
    let holding = gripping.after(&[finish(), Toggle(Inputs::GRIP)]).after(&rest);
    let fast_stop_asked = moving.after(&[Toggle(Inputs::FAST_STOP_OK)]);
    let fast_stop_unheard = moving.after(&[ToggleLine, Toggle(Inputs::FAST_STOP_OK), Wait]);
    let fast_stop_held = fast_stop_asked.after(&[AnswersAll]);
    let latched = fast_stop_held.after(&[Toggle(Inputs::FAST_STOP_OK)]);
    let acknowledged = latched.after(&[Toggle(Inputs::STOP_ACK)]);
    // A refresh is sent twelve times before the link counts as lost.
    let link_down = homed.after(&[ToggleLine]).after(&[const { Wait }; 14]);
    let mut roots = vec![
        ("switched on", switched_on),
        ("ready", ready),
        ("homing", homing),
        ("homed", homed.clone()),
        ("moving", moving),
        ("force limit sent", preparing),
        ("gripping", gripping),
        ("holding", holding),
        ("FAST STOP requested", fast_stop_asked),
        ("FAST STOP unheard", fast_stop_unheard),
        ("FAST STOP held", fast_stop_held),
        ("FAST STOP latched", latched),
        ("acknowledgement sent", acknowledged),
        ("link down", link_down),
    ];
    if has_bus {
        roots.push(("jogging", homed.after(&[Write(JOG_PLUS), AnswersAll])));
    }
    roots.into_iter().map(|(name, plant)| Root { name, plant }).collect()
}

#[cfg(test)]
mod tests {
    use super::super::action::{BUS, WIRES};
    use super::*;
    use crate::world::IDLE;
    use wsg_bridge_fw::io::Outputs;
    use wsg_protocol::CommandId;

    const BUSY: Outputs = Outputs::BUSY.union(Outputs::LINK_OK).union(Outputs::REFERENCED);
    const LOCKED: Outputs = Outputs::ERROR.union(Outputs::LINK_OK).union(Outputs::REFERENCED);

    #[test]
    fn roots_are_the_states_that_they_are_named_after() {
        for actions in [&WIRES[..], &BUS[..]] {
            for Root { name, plant } in roots(actions) {
                let outputs = match name {
                    "switched on" | "link down" => Outputs::ERROR,
                    "ready" => Outputs::READY | Outputs::LINK_OK,
                    "homing" => Outputs::BUSY | Outputs::LINK_OK,
                    "homed" => IDLE,
                    "holding" => IDLE | Outputs::HOLDING,
                    "moving" | "force limit sent" | "gripping" | "jogging" => BUSY,
                    "FAST STOP requested" | "FAST STOP unheard" => LOCKED | Outputs::BUSY,
                    _ => LOCKED,
                };
                assert_eq!(plant.outputs(), outputs, "{name}");
                let motion = match name {
                    "homing" => Some(CommandId::Homing),
                    "moving" | "jogging" | "FAST STOP unheard" => Some(CommandId::PrePosition),
                    "gripping" => Some(CommandId::GripPart),
                    _ => None,
                };
                assert_eq!(plant.motion(), motion, "{name}");
            }
        }
    }
}
