//! The whole spray robot at random, for the tests here and in the root's.

use nalgebra::Vector3;
use rand::RngExt;

use super::AsBuilt;
use super::spray_robot::{add_errors, full_robot};
use calibrig_model::{ActuatorMap, BeamSegment, BearingSide, CrankAxis, FourBar, PointLoad, SegmentLength};

pub(super) fn four_bar(robot: &mut AsBuilt) -> &mut FourBar {
    match &mut robot.actuators {
        ActuatorMap::Parallelogram { linkage: Some(linkage), .. } => linkage,
        _ => panic!("the full robot has a four-bar"),
    }
}

/// Any robot with errors, springs and loads around those of the full one, some of them rigid.
pub(super) fn random_full_robot(rng: &mut impl RngExt) -> AsBuilt {
    let mut robot = full_robot();
    add_errors(&mut robot, rng);
    let mut spread = |value: &mut f64, by: f64| *value *= 1.0 + rng.random_range(-by..by);
    for stiffness in &mut robot.statics.drive_stiffness {
        spread(stiffness, 0.3);
    }
    for bearing in &mut robot.statics.bearings {
        bearing.stiffness.iter_mut().for_each(|k| spread(k, 0.3));
    }
    if let Some(linkage) = &mut robot.statics.linkage {
        spread(&mut linkage.rod_stiffness, 0.3);
        spread(&mut linkage.rod_mass, 0.3);
    }
    for bearing in &mut robot.statics.bearings {
        bearing.side = if rng.random() { BearingSide::Fixed } else { BearingSide::Moving };
        bearing.at = rng.random_range(-0.5..0.5);
        for stiffness in &mut bearing.stiffness {
            if rng.random_range(0..6) == 0 {
                *stiffness = f64::INFINITY;
            }
        }
    }
    for stiffness in &mut robot.statics.drive_stiffness {
        if rng.random_range(0..6) == 0 {
            *stiffness = f64::INFINITY;
        }
    }
    for beam in robot.statics.beams.iter_mut().flatten() {
        let mut piece = beam.segments[0];
        piece.section.bending[0] *= rng.random_range(0.7..1.3);
        piece.section.shear[1] *= if rng.random() { f64::INFINITY } else { 1.3 };
        beam.segments[0] = piece;
        if let SegmentLength::Extension(housed) = &mut beam.segments[0].length {
            *housed = if rng.random() { 0.0 } else { 1.2 };
        }
        for _ in 0..rng.random_range(0..3) {
            let length = SegmentLength::Constant(rng.random_range(0.1..0.4));
            let mut section = piece.section;
            section.mass_per_length *= rng.random_range(0.0..1.0);
            beam.segments.insert(rng.random_range(0..=beam.segments.len()), BeamSegment { length, section });
        }
    }
    let arms = four_bar(&mut robot);
    for arm in [&mut arms.crank, &mut arms.lever] {
        arm.length += rng.random_range(-0.005..0.005);
        arm.angle += rng.random_range(-0.02..0.02);
        arm.along += rng.random_range(-0.02..0.02);
    }
    arms.rod += rng.random_range(-0.005..0.005);
    arms.axis = CrankAxis {
        x: rng.random_range(-0.005..0.005),
        y: rng.random_range(-0.005..0.005),
        rx: rng.random_range(-0.02..0.02),
        ry: rng.random_range(-0.02..0.02),
    };
    if let Some(linkage) = &mut robot.statics.linkage
        && rng.random_range(0..4) == 0
    {
        linkage.rod_stiffness = f64::INFINITY;
    }
    if rng.random_range(0..8) == 0 {
        robot.statics.linkage = None;
    }
    let mut within = |by: f64| Vector3::from([(); 3].map(|()| rng.random_range(-by..by)));
    robot.statics.gravity += within(0.5);
    let (at, force) = (within(0.4), within(200.0));
    robot.statics.loads.push(PointLoad { name: "cable".to_owned(), link: 3, at, mass: 12.0, force });
    robot
}

pub(super) fn random_shifts(rng: &mut impl RngExt) -> Vec<[f64; 6]> {
    (0..7).map(|_| [(); 6].map(|()| rng.random_range(-2e-3..2e-3))).collect()
}
