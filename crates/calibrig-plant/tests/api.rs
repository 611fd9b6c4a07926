//! What plant, tracker and session do with machines and commands that cannot be: always an error with the field in its text, never a panic.

use std::ops::ControlFlow;

use calibrig_model::geometry::Transform;
use calibrig_model::measurement::{Face, InstrumentTerm};
use calibrig_model::nalgebra::{Matrix3, Vector3};
use calibrig_model::random::{StreamSource, stream};
use calibrig_model::{
    ActuatorMap, Body, CraigLink, CrankAxis, FourBar, KinematicModel, LinkageArm, LinkageStatics, PointLoad,
    StaticProperties,
};
use calibrig_plant::effects::Effects;
use calibrig_plant::experiment::WorkingRegion;
use calibrig_plant::session::{MeasuringSession, SessionPlan};
use calibrig_plant::tracker::{
    Air, DriftLaw, EnvironmentLaw, ErrorLine, Instrument, LaserTracker, Misalignment, Motion, Preset,
    RANDOM_FRACTION, Shot,
};
use calibrig_plant::{AsBuilt, AsBuiltDistribution, Plant, SettleOptions, Spread};
use proptest::prelude::*;

fn body() -> Body {
    Body { mass: 4.0, centre_of_mass: Vector3::new(0.1, 0.0, 0.05), inertia: Matrix3::identity() * 0.1 }
}

fn machine() -> impl Strategy<Value = AsBuilt> {
    let link = (any::<bool>(), -1.0..1.0_f64, -3.0..3.0_f64, -1.0..1.0_f64, -3.0..3.0_f64).prop_map(
        |(turns, a, alpha, d, theta)| {
            let link = if turns { CraigLink::revolute("") } else { CraigLink::prismatic("") };
            link.row(a, alpha, d, theta)
        },
    );
    (prop::collection::vec(link, 1..=7), any::<bool>()).prop_map(|(mut links, linked)| {
        let (joints, linked) = (links.len(), linked && links.len() > 2);
        let mut actuators = ActuatorMap::Direct;
        if linked {
            for link in &mut links[1..3] {
                *link = CraigLink::revolute("").row(0.8, 0.0, 0.0, 0.0);
            }
            let arm = LinkageArm { length: 0.3, angle: 0.4, along: 0.0 };
            let linkage = Some(FourBar { crank: arm, lever: arm, rod: 0.8, axis: CrankAxis::default() });
            actuators = ActuatorMap::Parallelogram { shoulder: 1, elbow: 2, offset: 1.2, linkage };
        }
        let gravity = Vector3::new(0.0, -9.80665, 0.0);
        let mut statics = StaticProperties::of_drives(vec![body(); joints], vec![2e6; joints], gravity);
        statics.linkage = linked.then(|| LinkageStatics { rod_stiffness: 1e7, rod_mass: 1.0, crank: body() });
        AsBuilt {
            kinematics: KinematicModel {
                links,
                base_from_first: Transform::identity(),
                last_from_flange: Transform::identity(),
            },
            actuators,
            statics,
            target: Vector3::new(0.1, 0.05, 0.2),
            effects: Effects::default(),
        }
    })
}

type Fault = fn(&mut AsBuilt, usize, f64) -> &'static str;

const FAULTS: [Fault; 18] = [
    |m, _, _| {
        m.kinematics.links.clear();
        "no joints"
    },
    |m, joint, bad| {
        m.kinematics.links[joint].a = bad;
        "a of joint"
    },
    |m, joint, bad| {
        m.kinematics.links[joint].theta = bad;
        "theta of joint"
    },
    |m, _, bad| {
        m.kinematics.last_from_flange.translation.z = bad;
        "last_from_flange"
    },
    |m, _, _| {
        m.statics.bodies.pop();
        "bodies"
    },
    |m, _, _| {
        m.statics.drive_stiffness.push(1.0);
        "drive stiffnesses"
    },
    |m, _, _| {
        m.statics.bearings.clear();
        "bearings"
    },
    |m, _, _| {
        m.statics.beams.push(None);
        "beams"
    },
    |m, joint, _| {
        m.statics.bodies[joint].mass = -1.0;
        "mass"
    },
    |m, joint, bad| {
        m.statics.bodies[joint].centre_of_mass.x = bad;
        "centre of mass"
    },
    |m, joint, bad| {
        m.statics.bodies[joint].inertia[(1, 2)] = bad;
        "inertia"
    },
    |m, joint, _| {
        m.statics.drive_stiffness[joint] = f64::NAN;
        "stiffness"
    },
    |m, joint, bad| {
        m.statics.bearings[joint].at = bad;
        "bearing"
    },
    |m, _, bad| {
        m.statics.gravity.x = bad;
        "gravity"
    },
    |m, _, bad| {
        m.target.y = bad;
        "target"
    },
    |m, _, bad| {
        let linkage = m.actuators.four_bar().map(|(_, _, _, linkage)| *linkage);
        m.actuators = ActuatorMap::Parallelogram { shoulder: 0, elbow: usize::MAX, offset: bad, linkage };
        "joint"
    },
    |m, _, _| {
        m.actuators = ActuatorMap::Parallelogram { shoulder: 0, elbow: 0, offset: 0.0, linkage: None };
        "joint"
    },
    |m, _, _| {
        let zero = Vector3::zeros();
        m.statics.loads.push(PointLoad { name: String::new(), link: 99, at: zero, mass: 1.0, force: zero });
        "load"
    },
];

fn bad() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY])
}

const INSTRUMENT: Instrument = Instrument::of_noise(
    ErrorLine { offset: 15e-6, per_metre: 6e-6 },
    ErrorLine { offset: 10e-6, per_metre: 0.3e-6 },
    RANDOM_FRACTION,
);

fn distribution() -> AsBuiltDistribution {
    AsBuiltDistribution {
        spread: Spread::Normal,
        link_parameters: Vec::new(),
        length: 1e-3,
        angle: 1e-3,
        compliances: Vec::new(),
        compliance: 0.1,
        mass: 0.1,
        linkage_length: 1e-3,
        linkage_angle: 1e-3,
        crank_axis: 1e-3,
        crank_tilt: 1e-3,
        tilt: 1e-3,
        target: 1e-4,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn machines_that_cannot_be_are_refused(mut machine in machine(), fault in 0..FAULTS.len(), joint in any::<prop::sample::Index>(), bad in bad()) {
        let joint = joint.index(machine.kinematics.joint_count());
        let field = FAULTS[fault](&mut machine, joint, bad);
        match Plant::new(&machine, SettleOptions::default()) {
            Ok(_) => prop_assert!(false, "{}: taken for valid", field),
            Err(error) => prop_assert!(error.to_string().contains(field), "{}: {}", field, error),
        }
        // Of a machine that cannot be, others are drawn, and refused in their turn.
        let drawn = distribution().draw(&machine, &mut stream(1, 0, StreamSource::AsBuilt));
        prop_assert!(Plant::new(&drawn, SettleOptions::default()).is_err());
    }

    #[test]
    fn commands_that_are_not_the_machines_are_refused(machine in machine(), joint in any::<prop::sample::Index>(), bad in bad()) {
        let joints = machine.kinematics.joint_count();
        let mut plant = Plant::new(&machine, SettleOptions::default()).expect("a machine");
        let mut nan = vec![0.1; joints];
        nan[joint.index(joints)] = bad;
        for command in [vec![], vec![0.1; joints + 1], vec![0.1; joints - 1], nan] {
            let error = plant.settle(&command).expect_err("no command of this machine");
            prop_assert!(error.to_string().contains("command"), "{}", error);
        }
        for displacements in [vec![[0.0; 6]; joints + 1], vec![[bad; 6]; joints]] {
            let error = plant.settle_displaced(&vec![0.1; joints], &displacements).expect_err("no displacements");
            prop_assert!(error.to_string().contains("displacement"), "{}", error);
        }
        // And a sound one returns, at rest or not.
        let _ = plant.settle(&vec![0.1; joints]);
    }

    #[test]
    fn options_with_which_nothing_settles_are_refused(machine in machine(), which in 0..5_usize, bad in prop_oneof![bad(), Just(0.0), Just(-1.0)]) {
        let mut options = SettleOptions::default();
        let field = match which {
            0 => { options.dt = bad; "dt" }
            1 => { options.max_steps = 0; "max_steps" }
            2 => { options.tip_tolerance = bad; "tip_tolerance" }
            3 => { options.residual_tolerance = bad; "residual_tolerance" }
            _ => { options.closure_tolerance = bad; "closure_tolerance" }
        };
        match Plant::new(&machine, options) {
            Ok(_) => prop_assert!(false, "{}: taken for valid", field),
            Err(error) => prop_assert!(error.to_string().contains(field), "{}: {}", field, error),
        }
    }

    #[test]
    fn trackers_refuse_what_they_cannot_measure(
        place in prop::array::uniform3(prop_oneof![-40.0..40.0_f64, bad()]), up in prop::array::uniform3(prop_oneof![Just(0.0), -1.0..1.0_f64, bad()]),
        fraction in prop_oneof![0.0..1.0_f64, bad(), Just(-0.1)]
    ) {
        let instrument = Instrument { random_fraction: fraction, ..INSTRUMENT };
        let mut rng = stream(1, 0, StreamSource::IdentificationNoise);
        let tracker = LaserTracker::levelled(instrument, Vector3::new(1.0, 0.5, 3.0), 0.3, &Vector3::from(up));
        match tracker.measure(&Vector3::from(place), &Shot::default(), &mut rng) {
            Ok(reading) => {
                prop_assert!(reading.position().iter().all(|v| v.is_finite()) && fraction >= 0.0);
                prop_assert!(reading.covariance.is_some_and(|c| c.iter().all(|v| v.is_finite())));
            }
            Err(error) => prop_assert!(["range", "instrument"].iter().any(|what| error.to_string().contains(what)), "{}", error),
        }
    }

    #[test]
    fn misaligned_trackers_read_a_finite_point_or_say_why_not(
        place in prop::array::uniform3(prop_oneof![-9.0..9.0_f64, Just(0.0), bad()]), size in prop_oneof![0.0..2.0_f64, bad()], back in any::<bool>(),
        errors in prop::collection::vec((0..InstrumentTerm::ALL.len(), prop_oneof![-1.0..1.0_f64, bad()]), 0..5),
        time in prop_oneof![0.0..1e5_f64, bad()]
    ) {
        let mut tracker = LaserTracker::levelled(Preset::At500.instrument(), Vector3::new(1.0, 0.5, 3.0), 0.3, &Vector3::z());
        tracker.conditions.drift = Some(DriftLaw { ramp: Motion { shift: size, turn: size }, warm_up_time: 10.0, ..DriftLaw::default() });
        if let Ok(drawn) = tracker.drawn(1, 0, 0, 100.0) {
            tracker = drawn;
        }
        tracker.errors.misalignment = Misalignment::of(errors.iter().map(|(term, x)| (InstrumentTerm::ALL[*term], *x)));
        let face = if back { Face::Back } else { Face::Front };
        let read = tracker.measure(&Vector3::from(place), &Shot { face, ..Shot::at(time) }, &mut stream(1, 0, StreamSource::IdentificationNoise));
        match read {
            Ok(reading) => prop_assert!(reading.position().iter().all(|v| v.is_finite()) && reading.range > 0.0),
            Err(error) => prop_assert!(["range", "out of reach: the beam misses it"].iter().any(|what| error.to_string().contains(what)), "{}", error),
        }
        let air = Air { temperature: size, pressure: 1e5 * size, humidity: size };
        let law = EnvironmentLaw { air, sensor_sigma: air, gradient: size };
        prop_assert_eq!(law.check().is_ok() && size.is_finite(), law.check().is_ok());
    }

    #[test]
    fn sessions_refuse_regions_of_another_machine(machine in machine(), centre in 0..9_usize, width in 0..9_usize, bad in prop_oneof![bad(), Just(0.1)]) {
        let joints = machine.kinematics.joint_count();
        let mut region = WorkingRegion { centre: vec![0.1; centre], half_width: vec![0.05; width] };
        region.half_width.iter_mut().take(1).for_each(|width| *width = bad);
        let tracker = LaserTracker::levelled(INSTRUMENT, Vector3::new(5.0, 0.5, 3.0), 0.3, &Vector3::y());
        let session = MeasuringSession {
            as_built: &machine,
            actuators: &machine.actuators,
            region: &region,
            listed: [None; 2],
            identification_poses: 2,
            verification_poses: 0,
            tracker: &tracker,
            outliers: None,
            probe: None,
            nests: &[],
            nest_sigma: 1e-5,
            target_covariance: &(Matrix3::identity() * 1e-10),
            plan: &SessionPlan::default(),
        };
        let mut plant = Plant::new(&machine, SettleOptions::default()).expect("a machine");
        let measured = session.measure(&mut plant, 1, 0, &mut |_| ControlFlow::Continue(()));
        if centre != joints || width != joints || !bad.is_finite() {
            let text = measured.expect_err("another machine").to_string();
            prop_assert!(text.contains("working region"), "{}", text);
        }
    }
}
