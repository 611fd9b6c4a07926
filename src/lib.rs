//! Calibration of large robots with a laser tracker, on a virtual testbed whose truth is known and on real measurements.
//!
//! # The flow
//!
//! ```text
//! scenario ──► AsBuilt ──► plant ──► tracker ──► MeasurementSet ──► identify ──► evaluation ──► report, recording
//!     └──────► CalibrationModel (nominal) ─────────────────────────────┘
//! ```
//!
//! [`scenario`] describes both the truth and what is known of it; [`plant`] (rapier) and [`tracker`] turn the truth into a
//! [`MeasurementSet`](measurement::MeasurementSet), the only thing that [`identification`] sees beside the nominal
//! [`CalibrationModel`](model::CalibrationModel). Files and recordings of real robots enter at the same place. [`pipeline`] tells this story.
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
//! | δq | deflection of the drives under gravity, predicted from the nominal robot | [`elastostatics`] |
//! | p | target in the base frame: Craig/Hayati chain and target offset | [`kinematics`] |
//! | T | `tracker_from_base` | [`geometry`] |
//! | mᵢ, Wᵢ | reading, and the inverse Cholesky factor of its covariance | [`measurement`] |
//! | Lₖ | priors: base nests, measured target, making tolerance | [`identification`] |
//!
//! # Example
//!
//! Two revolute joints with parallel axes: the offsets d of the two do the same, so the rules keep one of them and add Hayati's beta.
//!
//! ```
//! use calibrig::geometry::Transform;
//! use calibrig::identification::neighbour_axis_rules;
//! use calibrig::model::{CraigLink, JointKind, KinematicModel};
//!
//! let link = |name: &str, a: f64| CraigLink {
//!     name: name.to_owned(),
//!     kind: JointKind::Revolute,
//!     a,
//!     alpha: 0.0,
//!     beta: 0.0,
//!     d: 0.0,
//!     theta: 0.0,
//!     limits: [-3.0, 3.0],
//! };
//! let links = vec![link("shoulder", 0.0), link("elbow", 1.35)];
//! let (kept, groups) = neighbour_axis_rules(&KinematicModel { links, last_from_flange: Transform::identity() });
//! assert_eq!(groups[0].to_string(), "delta_d1 with delta_d2");
//! assert!(kept.iter().any(|id| id.to_string() == "delta_beta2"));
//! ```

pub use calibrig_estimation::{elastostatics, evaluation, identification, kinematics, validation};
pub use calibrig_files as files;
pub use calibrig_model as model;
pub use calibrig_model::{geometry, measurement, nalgebra, random, statistics};
pub use calibrig_plant as plant;
pub use calibrig_plant::{experiment, tracker};

pub mod cli;
pub mod montecarlo;
pub mod pipeline;
pub mod recording;
pub mod replay;
pub mod report;
pub mod scenario;
