//! Random places that a robot can reach.

use calibrig_estimation::inverse::{InverseKinematics, InverseOptions};

use super::robots::{NAMES, goals, is_within, joints, model, off, rigid, tool, trials};

/// At least 999 of 1000 of every kind are solved, each within the limits and as the forward kinematics of the command has it. The bound holds for
/// all robots together: of one kind of one robot there are too few trials in a quick run.
#[test]
fn random_places_within_reach_are_reached() {
    let each = trials(100, 3400);
    let (mut asked, mut failed) = ([0_u32; 3], [0_u32; 3]);
    for name in NAMES {
        let (model, tool) = (model(name), tool());
        let mut inverse = InverseKinematics::new(&model, tool).expect("a robot");
        let options = InverseOptions::default();
        let (mut starts, mut unsolved) = ([0; 3], [0; 3]);
        for joints in (0..each).filter_map(|index| joints(&model, index)) {
            let command = model.actuators.command_from_joints(&joints);
            let (place, _) = rigid(&model, &command, &tool);
            for (kind, goal) in goals(&place).iter().enumerate() {
                asked[kind] += 1;
                let Ok(found) = inverse.solve(goal, &options) else {
                    unsolved[kind] += 1;
                    continue;
                };
                starts[kind] += found.starts;
                let (there, joints) = rigid(&model, &found.command, &tool);
                let (position, angle) = off(goal, &there);
                assert!(position <= 1e-9 && angle <= 1e-9, "{name} {kind}: {position} m, {angle} rad off");
                assert!(is_within(&model, &joints, 1e-9), "{name} {kind}: {joints:?}");
            }
        }
        println!("{name}: of {each} a kind, unsolved {unsolved:?}; starts in all {starts:?}");
        failed.iter_mut().zip(unsolved).for_each(|(all, own)| *all += own);
    }
    println!("of {asked:?} places by kind, unsolved {failed:?}");
    let (asked, failed): (u32, u32) = (asked.iter().sum(), failed.iter().sum());
    assert!(f64::from(failed) <= 1e-3 * f64::from(asked), "{failed} of {asked}");
}

/// The same call gives the same bits, whatever was asked before.
#[test]
fn a_solution_does_not_depend_on_what_was_asked_before() {
    let (model, tool) = (model("spray_painter"), tool());
    let places: Vec<_> = (0..20)
        .filter_map(|index| joints(&model, index))
        .map(|joints| rigid(&model, &model.actuators.command_from_joints(&joints), &tool).0)
        .collect();
    let mut one = InverseKinematics::new(&model, tool).expect("a robot");
    let options = InverseOptions::default();
    let forth: Vec<_> = places.iter().map(|place| one.solve(&goals(place)[1], &options)).collect();
    let mut back: Vec<_> = places.iter().rev().map(|place| one.solve(&goals(place)[1], &options)).collect();
    back.reverse();
    assert_eq!(forth, back);
}
