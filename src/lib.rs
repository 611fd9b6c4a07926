//! Calibration of large robots with a laser tracker, on a virtual testbed whose truth is known and on real measurements.
//!
//! # The flow
//!
//! ```text
//! scenario ──► AsBuilt ──► plant ──► tracker ──► MeasurementSet ──► identify ──► evaluation ──► report, recording
//!     └──────► CalibrationModel (nominal) ─────────────────────────────┘
//! ```
//!
//! [`scenario`] describes both the truth and what is known about it; [`plant`] (rapier) and [`tracker`] turn the truth into a
//! [`MeasurementSet`](measurement::MeasurementSet), the only thing that [`identification`] sees besides the nominal
//! [`CalibrationModel`](model::CalibrationModel). Files and recordings of real robots enter at the same place. [`pipeline`] connects the
//! steps.
//!
//! # The equation
//!
//! [`identification::identify`] minimises over the parameters x
//!
//! ```text
//! Σᵢ ‖Wᵢ ( T(x) · p(q(uᵢ) + δq(uᵢ); x) − mᵢ )‖²  +  Σₖ ‖Lₖ x‖²
//! ```
//!
//! | term | meaning | module |
//! | --- | --- | --- |
//! | uᵢ, q | actuator command, and the joint variables that it sets | [`model::ActuatorMap`] |
//! | δq | deflection under gravity: predicted from the nominal robot, or in the coupled modes that of the robot at x | [`elastostatics`] |
//! | p | target in the base frame: Craig/Hayati chain and target offset | [`kinematics`] |
//! | T | `tracker_from_base` | [`geometry`] |
//! | mᵢ, Wᵢ | reading, and the inverse Cholesky factor of its covariance | [`measurement`] |
//! | Lₖ | priors: base nests, measured target, making tolerance, compliances, terms | [`identification`] |
//!
//! # A robot in code
//!
//! The example states, measures and identifies an arm of four joints. The tracker's place and the target's place on the flange are
//! unknown: the default options identify both, with a complete independent set of link parameters, and report their assumptions.
//!
//! ```
//! use calibrig::identification::{IdentificationOptions, identify};
//! use calibrig::kinematics::target_in_base;
//! use calibrig::measurement::MeasurementSet;
//! use calibrig::model::{CalibrationModel, CraigLink};
//! use calibrig::nalgebra::Vector3;
//! use std::f64::consts::FRAC_PI_2;
//!
//! // Rows of Craig's table: a (m), alpha (rad), d (m), theta (rad); limits in rad.
//! let robot = CalibrationModel::new(vec![
//!     CraigLink::revolute("waist").row(0.0, 0.0, 0.8, 0.0).limits(-3.0, 3.0),
//!     CraigLink::revolute("shoulder").row(0.3, -FRAC_PI_2, 0.0, 0.0).limits(-2.0, 2.0),
//!     CraigLink::revolute("elbow").row(1.1, 0.0, 0.0, 0.0).limits(-2.0, 2.0),
//!     CraigLink::revolute("wrist").row(0.2, -FRAC_PI_2, 1.2, 0.0).limits(-3.0, 3.0),
//! ])?;
//! // Instead of a tracker: an upper arm 1.5 mm longer than drawn, seen with errors of up to 20 um.
//! let mut real = robot.kinematics.clone();
//! real.links[2].a += 1.5e-3;
//! let mut points = Vec::new();
//! for k in 0..50 {
//!     let command = [0.7, 1.1, 1.9, 2.3].map(|pace| 1.8 * (pace * f64::from(k)).sin());
//!     let target = target_in_base(&real, &command, &Vector3::new(0.10, 0.05, 0.20))?;
//!     let error = [5.3, 6.1, 7.7].map(|pace| 20e-6 * (pace * f64::from(k)).sin());
//!     points.push((command.to_vec(), target + Vector3::from(error)));
//! }
//! let set = MeasurementSet::of_points(points).with_sigma(15e-6);
//!
//! let estimate = identify(&robot, &set, &IdentificationOptions::default())?;
//! for p in &estimate.parameters {
//!     println!("{:14} {:10.6} +- {:.6} {}", p.id, p.value, p.sigma.unwrap_or(f64::NAN), p.id.unit());
//! }
//! estimate.assumptions.iter().for_each(|assumption| println!("{assumption}"));
//! let there = estimate.predict(&[0.5, -0.4, 0.9, 0.0])?;
//! let sigma = there.sigma().unwrap_or_default();
//! println!("at {:.5?} m, +- {:.6?} m", there.position.as_slice(), sigma.as_slice());
//! # let upper_arm = estimate.parameters.iter().find(|p| p.id.to_string() == "delta_a3").unwrap();
//! # assert!((upper_arm.value - 1.5e-3).abs() < 4.0 * upper_arm.sigma.unwrap(), "{upper_arm:?}");
//! # assert!(upper_arm.sigma.unwrap() < 20e-6 && estimate.is_sound(), "{:?}", estimate.warnings);
//! # assert!(there.sigma().is_some_and(|sigma| sigma.norm() < 100e-6), "{there:?}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # The same from files
//!
//! A robot's file states its table, limits and, if known, masses and stiffnesses, with the unit in every key; a file of measurements has
//! calibrig's own columns, or those that a [`ColumnMap`](files::ColumnMap) names. Everything is converted to SI and radians on reading.
//!
//! ```
//! use calibrig::files::{ColumnMap, Source, load_robot, parse_measurements};
//! use calibrig::identification::{IdentificationOptions, identify};
//! use calibrig::kinematics::target_in_base;
//! use calibrig::nalgebra::Vector3;
//! use std::path::Path;
//!
//! let robot = load_robot(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/models/ur5/robot.toml")))?;
//! let links = &robot.model.kinematics.links;
//! let kinds: Vec<_> = links.iter().map(|link| link.kind).collect();
//!
//! // What a tracker's program would have written: a forearm 0.8 mm longer than drawn, rounded to 10 um.
//! let mut real = robot.model.kinematics.clone();
//! real.links[3].a -= 0.8e-3;
//! let mut text = "q1_rad,q2_rad,q3_rad,q4_rad,q5_rad,q6_rad,x_m,y_m,z_m\n".to_owned();
//! for k in 0..60 {
//!     let q = [0.7, 1.1, 1.9, 2.3, 2.9, 3.7].map(|pace| 2.5 * (pace * f64::from(k)).sin());
//!     let p = target_in_base(&real, &q, &Vector3::new(0.05, 0.03, 0.10))?;
//!     text += &q.map(|q| format!("{q:.9},")).concat();
//!     text += &format!("{:.5},{:.5},{:.5}\n", p.x, p.y, p.z);
//! }
//! let file = Source::new("measured.csv", text); // from a disk: read_measurements(path, ...)
//! let measured = parse_measurements(&file, &ColumnMap::default(), &kinds)?;
//!
//! let estimate = identify(&robot.model, &measured.set, &IdentificationOptions::default())?;
//! for p in estimate.parameters.iter().filter(|p| p.id.to_string() == "delta_a4") {
//!     println!("{} = {:.3} +- {:.3} mm", p.id, 1e3 * p.value, 1e3 * p.sigma.unwrap_or(f64::NAN));
//!     assert!((p.value + 0.8e-3).abs() < 10e-6);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # More
//!
//! The programs in `examples/` run from the root of the repository: `cargo run --release --no-default-features --example robot_in_code`,
//! and so on. `ARCHITECTURE.md` shows which crate is behind which module; vectors and matrices are those of the [`nalgebra`] that is
//! re-exported here.
//!
//! ```
//! // The same type as everywhere in the interface, without a dependency of one's own that could be of another version.
//! let up = calibrig::nalgebra::Vector3::z();
//! let set = calibrig::measurement::MeasurementSet::of_points([(vec![0.0], up)]);
//! assert_eq!(set.observations[0].reading.position(), up);
//! ```

pub use calibrig_campaign as campaign;
pub use calibrig_estimation::METHOD;
pub use calibrig_estimation::{
    compensation, elastostatics, evaluation, identification, inverse, kinematics, planning, two_face,
    validation,
};
pub use calibrig_files as files;
pub use calibrig_model as model;
pub use calibrig_model::{geometry, measurement, nalgebra, random, statistics};
pub use calibrig_plant as plant;
pub use calibrig_plant::{experiment, tracker};
pub use calibrig_recording as recording;

pub mod cli;
pub mod compensate;
pub mod handover;
pub mod montecarlo;
pub mod pipeline;
pub mod pose_plan;
pub mod replay;
pub mod report;
pub mod scenario;
pub mod twin;
