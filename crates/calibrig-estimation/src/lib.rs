//! From measurements to a robot's parameters.
//!
//! [`identification::identify`] takes a [`CalibrationModel`](calibrig_model::CalibrationModel), a
//! [`MeasurementSet`](calibrig_model::measurement::MeasurementSet) and [options](identification::IdentificationOptions), and returns an
//! [`Estimate`](identification::Estimate): the parameters with their covariance, what the measurements cannot determine, what was assumed,
//! and a robot that predicts. [`calibration`] does this in every mode and judges the results. [`kinematics`] and [`elastostatics`] are the
//! models behind it; [`evaluation`] and [`validation`] show how good a result is without knowing the truth. Units are SI and radians.
//!
//! ```
//! use calibrig_estimation::identification::{IdentificationOptions, identify};
//! use calibrig_estimation::kinematics::target_in_base;
//! use calibrig_model::measurement::MeasurementSet;
//! use calibrig_model::nalgebra::Vector3;
//! use calibrig_model::{CalibrationModel, CraigLink};
//! use std::f64::consts::FRAC_PI_2;
//!
//! // Rows of Craig's table: a (m), alpha (rad), d (m), theta (rad); limits in m or rad.
//! let robot = CalibrationModel::new(vec![
//!     CraigLink::prismatic("rail").row(0.0, 0.0, 0.0, 0.0).limits(0.0, 3.0),
//!     CraigLink::revolute("shoulder").row(0.2, FRAC_PI_2, 0.0, 0.0).limits(-1.5, 1.5),
//!     CraigLink::revolute("elbow").row(0.9, 0.0, 0.0, 0.0).limits(-2.0, 2.0),
//!     CraigLink::revolute("wrist").row(0.1, -FRAC_PI_2, 0.7, 0.0).limits(-3.0, 3.0),
//! ])?;
//! // The machine: its elbow's zero is off by 2 mrad. Readings are off by up to 20 um.
//! let mut machine = robot.kinematics.clone();
//! machine.links[2].theta += 2e-3;
//! let mut points = Vec::new();
//! for k in 0..50 {
//!     let [rail, shoulder, elbow, wrist] = [0.7, 1.1, 1.9, 2.3].map(|pace| (pace * f64::from(k)).sin());
//!     let command = vec![1.5 + 1.4 * rail, 1.4 * shoulder, 1.9 * elbow, 2.5 * wrist];
//!     let target = target_in_base(&machine, &command, &Vector3::new(0.10, 0.05, 0.20))?;
//!     let error = Vector3::from([5.3, 6.1, 7.7].map(|pace| 20e-6 * (pace * f64::from(k)).sin()));
//!     points.push((command, target + error));
//! }
//! let set = MeasurementSet::of_points(points).with_sigma(15e-6);
//!
//! let estimate = identify(&robot, &set, &IdentificationOptions::default())?;
//! for p in &estimate.parameters {
//!     println!("{:14} {:10.6} +- {:.6} {}", p.id, p.value, p.sigma.unwrap_or(f64::NAN), p.id.unit());
//! }
//! estimate.assumptions.iter().for_each(|assumption| println!("{assumption}"));
//! let there = estimate.predict(&[1.0, 0.3, -0.8, 0.5])?;
//! let sigma = there.sigma().unwrap_or_default();
//! println!("at {:.5?} m, +- {:.6?} m", there.position.as_slice(), sigma.as_slice());
//! # let elbow = estimate.parameters.iter().find(|p| p.id.to_string() == "delta_theta3").unwrap();
//! # assert!((elbow.value - 2e-3).abs() < 4.0 * elbow.sigma.unwrap(), "{elbow:?}");
//! # assert!(elbow.sigma.unwrap() < 100e-6 && estimate.is_sound(), "{:?}", estimate.warnings);
//! # assert!(there.sigma().is_some_and(|sigma| sigma.norm() < 100e-6), "{there:?}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What this crate cannot see
//!
//! The machine as built, and everything that simulates and measures it: no estimate can look at the truth. This does not compile:
//!
//! ```compile_fail,E0432
//! use calibrig_plant::AsBuilt;
//! ```

/// Number of the method by which measurements become estimates. It is raised whenever the same measurements, model and options give
/// different estimates than before, even in the last bits, so that a recording shows whether its estimates can be reproduced. 1 stands for
/// everything before the number was recorded.
pub const METHOD: u32 = 4;

pub mod calibration;
pub mod circle_points;
pub mod compensation;
pub mod diagnosis;
pub mod elastostatics;
pub mod evaluation;
pub mod identification;
pub mod inverse;
pub mod kinematics;
pub mod planning;
pub mod plausibility;
pub mod two_face;
pub mod validation;
