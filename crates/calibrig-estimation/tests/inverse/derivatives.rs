//! Derivatives by commands against central differences of the predictions.

use calibrig_estimation::elastostatics::{Deflection, ElasticChain};
use calibrig_estimation::identification::{Mode, Predictor};
use calibrig_model::PoseQuery;
use calibrig_model::geometry::rotation_vector;
use calibrig_model::nalgebra::Vector3;

use super::robots::{NAMES, calibrated, joints, model};

/// Of every mode of every robot whose masses are known, at random poses; of the deflection that is taken from the nominal robot, what is held of it is
/// some hundredths of the softest.
#[test]
fn motions_by_command_are_central_differences() {
    let in_flange = Vector3::new(0.1, 0.15, 0.2);
    for name in NAMES {
        let model = model(name);
        for mode in Mode::ALL {
            if mode.needs_statics() && model.statics.is_none() {
                continue;
            }
            let robot = calibrated(&model, mode);
            let mut predictor = Predictor::new(&robot).expect("a robot");
            for joints in (0..4).filter_map(|index| joints(&model, index)) {
                let command = model.actuators.command_from_joints(&joints);
                let approach: Vec<i8> = command.iter().map(|c| if *c > 0.1 { 1 } else { -1 }).collect();
                let pose = PoseQuery::at(&command).approached(&approach);
                let (flange, motions) = predictor.by_command(pose, &in_flange).expect("a pose");
                let scale = motions.amax().max(1.0);
                for actuator in (0..command.len()).filter(|axis| model.actuators.is_commanded(*axis)) {
                    // Far below the shortest wave of a transmission error, far above what equilibria are found to.
                    let step = 1e-6;
                    let mut beside = |by: f64| {
                        let mut moved = command.clone();
                        moved[actuator] += by;
                        predictor.flange(PoseQuery::at(&moved).approached(&approach)).expect("a pose")
                    };
                    let (up, down) = (beside(step), beside(-step));
                    let point = |flange: &calibrig_model::geometry::Transform| {
                        flange.transform_point(&in_flange.into())
                    };
                    let moved = (point(&up) - point(&down)) / (2.0 * step);
                    let turned = rotation_vector(&(up.rotation * down.rotation.inverse())) / (2.0 * step);
                    let column = motions.column(actuator);
                    let off = (column.fixed_rows::<3>(0) - moved).norm()
                        + (column.fixed_rows::<3>(3) - turned).norm();
                    let bound = if mode == Mode::WithGravity { 5e-2 } else { 2e-6 };
                    assert!(
                        off <= bound * scale,
                        "{name}, {mode:?}, actuator {actuator}: {off} of {scale} at {flange}"
                    );
                }
            }
        }
    }
}

/// The spray painter's telescope is longer, softer and heavier at every command: without that part the derivative would be off by more.
#[test]
fn the_length_of_a_telescope_counts() {
    let model = model("spray_painter");
    let mut chain = ElasticChain::new(&model).expect("a robot");
    let in_flange = Vector3::new(0.1, 0.15, 0.2);
    let joints = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
    let command = model.actuators.command_from_joints(&joints);
    chain.settle(&command, &[], Deflection::Equilibrium).expect("rest");
    chain.prepare(&in_flange).expect("stable");
    let column = chain.column_of_command(4).expect("an actuator");
    let as_correction = chain.column_of_place(calibrig_model::TermPlace::Actuator(4)).expect("an actuator");
    let mut beside = |by: f64| {
        let mut moved = command.clone();
        moved[4] += by;
        chain.settle(&moved, &[], Deflection::Equilibrium).expect("rest");
        chain.target(&in_flange)
    };
    let step = 1e-4;
    let difference = (beside(step) - beside(-step)) / (2.0 * step);
    let (off, without) = ((column - difference).norm(), (as_correction - difference).norm());
    println!("off by {off:.1e}, without the length by {without:.1e} m/m");
    assert!(off < 1e-8 && without > 30.0 * off, "{off} {without}");
    assert!(chain.column_of_command(7).is_err());
}
