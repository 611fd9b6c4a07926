//! Robots, sets and options of which one thing is broken.

use std::slice::from_ref;

use calibrig_estimation::elastostatics::{Deflection, ElasticChain, apply};
use calibrig_estimation::identification::{
    ComplianceChoice, FrameChoice, IdentificationOptions, Loss, LossScale, MachineNoiseChoice, Mode,
    ParameterBound, ParameterChoice, Redundancy, TargetChoice, TermPrior, Tolerance, check_bounds,
    complete_set, explain, identifiability, identify, linearise, neighbour_axis_rules, prospect, spectrum,
    structural_poses, without_calibration,
};
use calibrig_estimation::kinematics::{
    command_from_joints, forward_kinematics, identification_jacobian, joints_from_command, link_frames,
    stacked_jacobian, target_in_base,
};
use calibrig_model::measurement::{MeasurementSet, Reading};
use calibrig_model::nalgebra::{Matrix3, Vector3};
use calibrig_model::{
    ActuatorMap, CalibrationModel, Compliance, CraigLink, KinematicModel, LinkTerm, LinkageStatics,
    ParameterId, PointLoad, TermPlace,
};
use proptest::prelude::*;

use crate::robots::{Case, body, case, command};
use crate::{names, refused};

/// Breaks something of a robot; gives what the error has to name, or `None` where the robot has no such thing.
type ModelFault = fn(&mut Case) -> Option<&'static str>;

fn link(case: &mut Case) -> &mut CraigLink {
    &mut case.model.kinematics.links[case.joint]
}

const CHAIN_FAULTS: [ModelFault; 10] = [
    |case| {
        case.model.kinematics.links.clear();
        Some("no joints")
    },
    |case| {
        link(case).a = case.bad;
        Some("a of joint")
    },
    |case| {
        link(case).alpha = case.bad;
        Some("alpha of joint")
    },
    |case| {
        link(case).beta = case.bad;
        Some("beta of joint")
    },
    |case| {
        link(case).d = case.bad;
        Some("d of joint")
    },
    |case| {
        link(case).theta = case.bad;
        Some("theta of joint")
    },
    |case| {
        link(case).limits = [1.0, -1.0];
        Some("limits of joint")
    },
    |case| {
        link(case).limits[0] = f64::NAN;
        Some("limits of joint")
    },
    |case| {
        case.model.kinematics.base_from_first.translation.y = case.bad;
        Some("base_from_first")
    },
    |case| {
        case.model.kinematics.last_from_flange.translation.x = case.bad;
        Some("last_from_flange")
    },
];

fn parallelogram(case: &mut Case, [shoulder, elbow]: [usize; 2], offset: f64) {
    let linkage = case.model.actuators.elbow().and_then(|drive| drive.linkage);
    case.model.actuators = ActuatorMap::Parallelogram { shoulder, elbow, offset, linkage };
}

const MODEL_FAULTS: [ModelFault; 28] = [
    |case| {
        case.model.motor_turns.push(None);
        Some("motor_turns")
    },
    |case| {
        case.model.motor_turns[case.joint] = Some(case.bad);
        Some("motor_turns")
    },
    |case| {
        case.model.motor_turns[case.joint] = Some(0.0);
        Some("motor_turns")
    },
    |case| {
        parallelogram(case, [99, 2], 0.0);
        Some("actuators.shoulder")
    },
    |case| {
        parallelogram(case, [0, usize::MAX], 0.0);
        Some("actuators.elbow")
    },
    |case| {
        parallelogram(case, [case.joint, case.joint], 0.0);
        Some("parallelogram")
    },
    |case| {
        let (ActuatorMap::Parallelogram { offset, .. }, bad) = (&mut case.model.actuators, case.bad) else {
            return None;
        };
        *offset = bad;
        Some("actuators.offset")
    },
    |case| {
        let ActuatorMap::Parallelogram { linkage: Some(linkage), .. } = &mut case.model.actuators else {
            return None;
        };
        linkage.rod = -0.1;
        Some("actuators.linkage.rod")
    },
    |case| {
        let ActuatorMap::Parallelogram { linkage: Some(linkage), .. } = &mut case.model.actuators else {
            return None;
        };
        linkage.crank.length = case.bad;
        Some("actuators.linkage.crank")
    },
    |case| {
        let ActuatorMap::Parallelogram { linkage: Some(linkage), .. } = &mut case.model.actuators else {
            return None;
        };
        linkage.lever.along = case.bad;
        Some("actuators.linkage.lever")
    },
    |case| {
        let ActuatorMap::Parallelogram { linkage: Some(_), elbow, .. } = &mut case.model.actuators else {
            return None;
        };
        *elbow = 3;
        (case.model.kinematics.links.len() > 3).then_some("parallelogram")
    },
    |case| {
        case.model.statics.as_mut()?.bodies.pop();
        Some("statics.bodies")
    },
    |case| {
        case.model.statics.as_mut()?.bodies[case.joint].mass = -1.0;
        Some("statics.bodies")
    },
    |case| {
        case.model.statics.as_mut()?.bodies[case.joint].inertia[(0, 1)] = case.bad;
        Some("statics.bodies")
    },
    |case| {
        case.model.statics.as_mut()?.drive_stiffness.push(1.0);
        Some("statics.drive_stiffness")
    },
    |case| {
        case.model.statics.as_mut()?.drive_stiffness.clear();
        Some("statics.drive_stiffness")
    },
    |case| {
        case.model.statics.as_mut()?.drive_stiffness[case.joint] = -1e5;
        Some("statics.drive_stiffness")
    },
    |case| {
        case.model.statics.as_mut()?.bearings.pop();
        Some("statics.bearings")
    },
    |case| {
        case.model.statics.as_mut()?.bearings[case.joint].stiffness[4] = f64::NAN;
        Some("statics.bearings.stiffness")
    },
    |case| {
        case.model.statics.as_mut()?.bearings[case.joint].at = case.bad;
        Some("statics.bearings.at")
    },
    |case| {
        case.model.statics.as_mut()?.beams.pop();
        Some("statics.beams")
    },
    |case| {
        case.model.statics.as_mut()?.beams[0].as_mut()?.segments.clear();
        Some("no segments")
    },
    |case| {
        case.model.statics.as_mut()?.beams[0].as_mut()?.segments[0].section.torsion = 0.0;
        Some("torsional stiffness")
    },
    |case| {
        case.model.statics.as_mut()?.gravity.y = case.bad;
        Some("statics.gravity")
    },
    |case| {
        let statics = case.model.statics.as_mut()?;
        statics.gravity = Vector3::zeros();
        statics.loads.clear();
        Some("statics.gravity is zero")
    },
    |case| {
        let (zero, name) = (Vector3::zeros(), String::new());
        let load = PointLoad { name, link: 99, at: zero, mass: 1.0, force: zero };
        case.model.statics.as_mut()?.loads.push(load);
        Some("statics.loads")
    },
    |case| {
        case.model.statics.as_mut()?.loads.first_mut()?.mass = -2.0;
        Some("statics.loads.mass")
    },
    |case| {
        let statics = case.model.statics.as_mut()?;
        if statics.linkage.is_some() {
            return None;
        }
        statics.linkage = Some(LinkageStatics { rod_stiffness: 1e7, rod_mass: 1.0, crank: body() });
        Some("statics.linkage")
    },
];

const SET_FAULTS: [ModelFault; 13] = [
    |case| {
        case.set.observations.clear();
        Some("no measurement")
    },
    |case| {
        case.set = MeasurementSet::default();
        Some("no measurement")
    },
    |case| {
        case.set.observations[0].command.pop();
        Some("commands")
    },
    |case| {
        case.set.observations[0].command.push(0.0);
        Some("commands")
    },
    |case| {
        case.set.observations[0].command[case.joint] = case.bad;
        Some("not a finite number")
    },
    |case| {
        case.set.observations[1].approach = vec![1; 99];
        Some("signs of approach")
    },
    |case| {
        case.set.observations[2].station = 7;
        Some("station or a target")
    },
    |case| {
        case.set.observations[2].target = usize::MAX;
        Some("station or a target")
    },
    |case| {
        case.set.observations[0].reading =
            Reading::Cartesian { position: Vector3::x() * case.bad, covariance: None };
        Some("not a finite number")
    },
    |case| {
        case.set.observations[0].time = case.bad;
        Some("not a finite number")
    },
    |case| {
        case.set.observations[0].temperature = Some(case.bad);
        Some("not a finite number")
    },
    |case| {
        case.set.targets[0].in_flange.z = case.bad;
        Some("target S1")
    },
    |case| {
        case.set.stations[0].nests.first_mut()?.in_base.x = case.bad;
        Some("station T1")
    },
];

fn coupled(case: &mut Case) -> Option<()> {
    case.model.statics.as_ref()?;
    case.options.mode = Mode::ElastoGeometric;
    Some(())
}

fn extended(case: &mut Case) -> Option<()> {
    coupled(case)?;
    case.options.mode = Mode::Extended;
    Some(())
}

fn fitted(case: &mut Case) -> Option<()> {
    (case.options.mode != Mode::WithoutCalibration && case.options.mode != Mode::Extended).then_some(())
}

const OPTION_FAULTS: [ModelFault; 23] = [
    |case| {
        case.options.unmodelled_sigma = case.bad;
        Some("unmodelled_sigma")
    },
    |case| {
        case.options.unmodelled_sigma = -1e-6;
        Some("unmodelled_sigma")
    },
    |case| {
        let joints = case.model.kinematics.joint_count();
        case.options.machine_noise = MachineNoiseChoice::Stated(vec![-1e-6; joints]);
        Some("machine_noise")
    },
    |case| {
        let joints = case.model.kinematics.joint_count();
        case.options.machine_noise = MachineNoiseChoice::Stated(vec![case.bad; joints]);
        Some("machine_noise")
    },
    |case| {
        let joints = case.model.kinematics.joint_count();
        case.options.machine_noise = MachineNoiseChoice::Stated(vec![1e-6; joints + 1]);
        Some("machine_noise")
    },
    |case| {
        case.options.solver.gradient = case.bad;
        Some("solver.gradient")
    },
    |case| {
        case.options.solver.relative_decrease = -1.0;
        Some("solver.relative_decrease")
    },
    |case| {
        case.options.solver.loss = Loss::Tukey { k: 0.0 };
        Some("solver.loss")
    },
    |case| {
        case.options.solver.loss_scale = LossScale::Fixed(case.bad);
        Some("solver.loss_scale")
    },
    |case| {
        fitted(case)?;
        case.options.tolerance = Some(Tolerance { length: case.bad, angle: 1e-3 });
        Some("tolerance")
    },
    |case| {
        fitted(case)?;
        case.options.parameters = ParameterChoice::Listed(vec![ParameterId::link(99, LinkTerm::A)]);
        Some("delta_a100")
    },
    |case| {
        fitted(case)?;
        case.options.parameters = ParameterChoice::Listed(ParameterId::all_of_frame(0));
        Some("frame_x")
    },
    |case| {
        coupled(case)?;
        case.options.masses = vec![99];
        Some("mass100")
    },
    |case| {
        coupled(case)?;
        (case.options.masses, case.options.mass_sigma) = (vec![0], 0.0);
        Some("prior of the masses")
    },
    |case| {
        coupled(case)?;
        case.options.compliance_sigma = case.bad;
        Some("prior of the compliances")
    },
    |case| {
        coupled(case)?;
        case.options.compliances = ComplianceChoice::Listed(vec![Compliance::Drive { joint: 99 }]);
        Some("compliance_drive100")
    },
    |case| {
        extended(case)?;
        case.options.terms = Some(vec!["growth".to_owned()]);
        Some("growth")
    },
    |case| {
        extended(case)?;
        let family = "ratio".to_owned();
        case.options.term_priors = vec![TermPrior { family, length: Some(case.bad), angle: Some(0.0) }];
        Some("ratio")
    },
    |case| {
        case.options.frame = FrameChoice::Nests;
        case.set.stations[0].nests.clear();
        Some("station T1")
    },
    |case| {
        case.options.target = TargetChoice::Measured;
        case.set.targets[0].covariance = None;
        Some("target S1")
    },
    |case| {
        case.options.target = TargetChoice::Measured;
        case.set.targets[0].covariance = Some(-Matrix3::identity());
        Some("target S1")
    },
    |case| {
        let zero = Some(Matrix3::zeros());
        for observation in &mut case.set.observations {
            observation.reading =
                Reading::Cartesian { position: observation.reading.position(), covariance: zero };
        }
        Some("pose 1: the covariance")
    },
    |case| {
        case.model.statics = None;
        case.options.mode = Mode::WithGravity;
        Some("masses, stiffnesses and gravity")
    },
];

/// Everything that takes a robot as a chain.
fn chain_is_refused(chain: &KinematicModel, field: &str) {
    let q = vec![0.1; chain.joint_count()];
    let (target, ids) = (Vector3::new(0.1, 0.0, 0.2), ParameterId::all_of_links(chain.joint_count()));
    names(chain.check(), field, "check");
    if !["base_from_first", "last_from_flange"].contains(&field) {
        names(KinematicModel::new(chain.links.clone()), field, "KinematicModel::new");
        names(CalibrationModel::new(chain.links.clone()), field, "CalibrationModel::new");
    }
    names(forward_kinematics(chain, &q), field, "forward_kinematics");
    names(link_frames(chain, &q), field, "link_frames");
    names(target_in_base(chain, &q, &target), field, "target_in_base");
    names(identification_jacobian(chain, &q, &target, &ids), field, "identification_jacobian");
    names(stacked_jacobian(chain, &[&q], &target, &ids), field, "stacked_jacobian");
    names(complete_set(chain, true, true), field, "complete_set");
    names(identifiability(chain, from_ref(&q), &target, true, false), field, "identifiability");
    names(spectrum(chain, from_ref(&q), &target, &ids), field, "spectrum");
    let mut joints = q.clone();
    names(joints_from_command(chain, &ActuatorMap::Direct, &q, &mut joints), field, "joints_from_command");
    names(command_from_joints(chain, &ActuatorMap::Direct, &q), field, "command_from_joints");
    // These have no error to give: they must return.
    let _ = structural_poses(chain, 5);
    let _ = neighbour_axis_rules(chain);
}

/// Everything that takes a robot.
fn model_is_refused(case: &Case, sound: &Case, field: &str) {
    let Case { model, set, options, .. } = case;
    names(model.check(), field, "check");
    names(identify(model, set, options), field, "identify");
    names(without_calibration(model, set, Loss::Squared), field, "without_calibration");
    names(prospect(model, set, options), field, "prospect");
    names(ElasticChain::new(model), field, "ElasticChain::new");
    let mut chain = ElasticChain::new(&sound.model).expect("a robot");
    names(chain.set_model(model), field, "ElasticChain::set_model");
    let id = ParameterId::link(0, LinkTerm::A);
    names(apply(&mut sound.model.clone(), model, id, 1e-3), field, "apply, reference");
    names(apply(&mut model.clone(), &sound.model, id, 1e-3), field, "apply");
    let bound = ParameterBound { id, lower: -1.0, upper: 1.0 };
    let bounded = IdentificationOptions { bounds: vec![bound], ..options.clone() };
    for mode in Mode::ALL {
        let _ = check_bounds(model, &[mode], &bounded, &set.stations, &set.targets);
    }
    let _ = model.compliances();
}

fn faulty(faults: &'static [ModelFault]) -> impl Strategy<Value = (Case, Case, &'static str)> {
    (case(), 0..faults.len()).prop_filter_map("the robot has no such thing", |(sound, fault)| {
        let mut case = sound.clone();
        let field = faults[fault](&mut case)?;
        Some((sound, case, field))
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn a_chain_that_cannot_be_is_refused((sound, case, field) in faulty(&CHAIN_FAULTS)) {
        chain_is_refused(&case.model.kinematics, field);
        model_is_refused(&case, &sound, field);
    }

    #[test]
    fn a_robot_that_cannot_be_is_refused((sound, case, field) in faulty(&MODEL_FAULTS)) {
        model_is_refused(&case, &sound, field);
        let CalibrationModel { actuators, statics, motor_turns, .. } = case.model;
        let whole = |model: CalibrationModel| model.with_motor_turns(motor_turns);
        let plain = CalibrationModel::new(sound.model.kinematics.links).expect("a chain");
        // Masses of a four-bar and its lengths are stated one after the other: in one of the two orders.
        let built = plain.with_actuators(actuators).and_then(|model| match statics {
            Some(statics) => model.with_statics(statics),
            None => Ok(model),
        });
        names(built.and_then(whole), field, "with_...");
    }

    #[test]
    fn measurements_that_cannot_be_are_refused((_, case, field) in faulty(&SET_FAULTS)) {
        let Case { model, set, options, .. } = &case;
        names(set.check(model.kinematics.joint_count()), field, "MeasurementSet::check");
        names(identify(model, set, options), field, "identify");
        names(without_calibration(model, set, Loss::Squared), field, "without_calibration");
        names(prospect(model, set, options), field, "prospect");
    }

    #[test]
    fn options_that_cannot_be_are_refused((sound, case, field) in faulty(&OPTION_FAULTS)) {
        // A robot whose points are all on one line is refused for that.
        prop_assume!(without_calibration(&sound.model, &sound.set, Loss::Squared).is_ok());
        let Case { model, set, options, .. } = &case;
        names(identify(model, set, options), field, "identify");
        names(prospect(model, set, options), field, "prospect");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// What is valid gives an estimate, or an error that says what is missing of it; either way everything that follows from it returns.
    #[test]
    fn what_can_be_is_identified_or_says_what_is_missing(mut case in case(), redundant in 0..3_usize) {
        case.options.redundant = Redundancy::ALL[redundant];
        // Not to wait for robots that some drawings are: a few iterations show a panic as well.
        case.options.solver.max_iterations = 8;
        let Case { model, set, options, .. } = &case;
        let _ = without_calibration(model, set, Loss::Squared).map_err(|error| assert!(!error.to_string().is_empty()));
        if let Ok(prospect) = prospect(model, set, options) {
            prop_assert!(prospect.measured_rank <= prospect.parameters.len());
        }
        match identify(model, set, options) {
            Err(error) => prop_assert!(!error.to_string().is_empty()),
            Ok(estimate) => {
                linearise(model, set, options, &estimate).expect("its own system");
                for observation in &set.observations {
                    if let Ok(predicted) = estimate.predict(observation) {
                        prop_assert_eq!(predicted.jacobian.ncols(), estimate.parameters.len());
                    }
                }
                prop_assert_eq!(estimate.parameters.iter().all(|p| p.value.is_finite()), true);
            }
        }
    }

    #[test]
    fn poses_and_parameters_of_another_chain_are_refused(case in case()) {
        let Case { model, joint, bad, .. } = &case;
        let chain = &model.kinematics;
        let (n, target) = (chain.joint_count(), Vector3::new(0.1, 0.0, 0.2));
        let good = command(model, 1);
        let mut nan = good.clone();
        nan[*joint] = *bad;
        let ids = ParameterId::all_of_links(n);
        for q in [Vec::new(), good[1..].to_vec(), [&good[..], &[0.0]].concat(), nan] {
            names(forward_kinematics(chain, &q), "joint variables", "forward_kinematics");
            names(link_frames(chain, &q), "joint variables", "link_frames");
            names(target_in_base(chain, &q, &target), "joint variables", "target_in_base");
            names(identification_jacobian(chain, &q, &target, &ids), "joint variables", "identification_jacobian");
            names(stacked_jacobian(chain, &[&good, &q], &target, &ids), "joint variables", "stacked_jacobian");
            names(spectrum(chain, from_ref(&q), &target, &ids), "joint variables", "spectrum");
            names(identifiability(chain, from_ref(&q), &target, true, true), "joint variables", "identifiability");
            let report = complete_set(chain, true, true).expect("a chain");
            names(explain(&report, chain, from_ref(&q), &target), "joint variables", "explain");
            names(joints_from_command(chain, &model.actuators, &q, &mut good.clone()), "command", "joints_from_command");
            names(command_from_joints(chain, &model.actuators, &q), "joint variables", "command_from_joints");
            let mut elastic = ElasticChain::new(model).expect("a robot");
            names(elastic.settle(&q, &[], Deflection::Equilibrium), "command", "settle");
            names(elastic.settle_at(&q, &[], &[]), "command", "settle_at");
        }
        names(
            joints_from_command(chain, &model.actuators, &good, &mut vec![0.0; n + 1]), "joint variables", "joints_from_command"
        );
        for id in [
            ParameterId::link(n, LinkTerm::Beta),
            ParameterId::Frame { station: 0, component: 6 },
            ParameterId::Target { target: 0, axis: 3 },
        ] {
            let name = id.to_string();
            names(identification_jacobian(chain, &good, &target, &[id]), &name, "identification_jacobian");
            names(spectrum(chain, from_ref(&good), &target, &[id]), &name, "spectrum");
        }
        let nowhere = Vector3::new(0.0, *bad, 0.0);
        names(target_in_base(chain, &good, &nowhere), "target's offset", "target_in_base");
        names(spectrum(chain, from_ref(&good), &nowhere, &ids), "target's offset", "spectrum");
        names(identifiability(chain, from_ref(&good), &nowhere, true, true), "target's offset", "identifiability");
        let mut report = complete_set(chain, true, true).expect("a chain");
        report.selected.push(ParameterId::link(n, LinkTerm::D));
        names(explain(&report, chain, &[], &target), &format!("delta_d{}", n + 1), "explain");
    }

    #[test]
    fn an_elastic_chain_refuses_what_is_of_another(case in case(), other in crate::robots::model()) {
        let Case { model, joint, bad, .. } = &case;
        let n = model.kinematics.joint_count();
        let mut chain = ElasticChain::new(model).expect("a robot");
        let good = command(model, 2);
        // Columns before anything was settled mean nothing, but do not panic.
        let _ = chain.column(ParameterId::link(0, LinkTerm::A)).expect("its own");
        if chain.set_model(&other).is_ok() {
            prop_assert_eq!(other.kinematics.joint_count(), n);
            chain.set_model(model).expect("its own");
        }
        for place in [TermPlace::Actuator(n), TermPlace::Frame { joint: 0, component: 6 }, TermPlace::Frame { joint: n, component: 0 }] {
            names(chain.settle(&good, &[(place, 1e-3)], Deflection::None), "correction", "settle");
            names(chain.column_of_place(place), "correction", "column_of_place");
        }
        names(chain.settle(&good, &[(TermPlace::Actuator(*joint), *bad)], Deflection::None), "correction", "settle");
        prop_assert_eq!(chain.drive_deflection(n), None);
        prop_assert!(chain.drive_deflection(*joint).is_some());
        for id in [
            ParameterId::link(n, LinkTerm::A),
            ParameterId::Mass { link: n },
            ParameterId::Compliance(Compliance::Drive { joint: n }),
            ParameterId::Compliance(Compliance::Bearing { joint: 0, axis: 6 }),
            ParameterId::Compliance(Compliance::Beam { link: usize::MAX - 1 }),
            ParameterId::Target { target: 0, axis: 3 },
        ] {
            names(chain.column(id), &id.to_string(), "column");
            names(apply(&mut model.clone(), model, id, 0.1), &id.to_string(), "apply");
        }
        names(apply(&mut model.clone(), model, ParameterId::link(*joint, LinkTerm::D), *bad), "value", "apply");
        names(apply(&mut model.clone(), model, ParameterId::Mass { link: *joint }, -1.5), "value", "apply");
        if chain.settle(&good, &[], Deflection::Equilibrium).is_ok() {
            names(chain.prepare(&Vector3::new(*bad, 0.0, 0.0)), "target's offset", "prepare");
            let deflections = chain.deflections().to_vec();
            chain.settle_at(&good, &[], &deflections).expect("its own");
            let many = vec![0.0; deflections.len() + 3];
            names(chain.settle_at(&good, &[], &many), "deflections", "settle_at");
            names(chain.settle_at(&good, &[], &deflections[1..][..deflections.len().saturating_sub(3)]), "deflections", "settle_at");
            let mut nan = deflections;
            nan[0] = *bad;
            names(chain.settle_at(&good, &[], &nan), "deflections", "settle_at");
        }
    }

    #[test]
    fn bounds_that_cannot_be_kept_are_refused(case in case(), limits in (-2.0..2.0_f64, -2.0..2.0_f64), which in 0..7_usize) {
        let Case { model, set, options, joint, .. } = &case;
        let id = match which {
            0 => ParameterId::link(99, LinkTerm::A),
            1 => ParameterId::Compliance(Compliance::Rod),
            2 => ParameterId::Frame { station: 9, component: 1 },
            3 => ParameterId::Target { target: 9, axis: 1 },
            4 => ParameterId::Mass { link: *joint },
            _ => ParameterId::link(*joint, LinkTerm::A),
        };
        let (lower, upper) = if which == 6 { (f64::NAN, limits.1) } else { limits };
        let bound = ParameterBound { id, lower, upper };
        let bounded = IdentificationOptions { bounds: vec![bound, bound], ..options.clone() };
        // Twice the same, whatever it is.
        let text = refused(check_bounds(model, &Mode::ALL, &bounded, &set.stations, &set.targets), "check_bounds");
        prop_assert!(text.contains(&id.to_string()), "{}", text);
        if bound.check().is_err() {
            names(identify(model, set, &bounded), &id.to_string(), "identify");
        }
    }
}
