//! The seven-joint spray robot of the tests (here and in the root's) and of the bench, with plausible bodies and drives.

use nalgebra::{Matrix3, Vector3};
use rand::RngExt;

use super::{AsBuilt, Effects};
use calibrig_model::geometry::Transform;
use calibrig_model::{
    ActuatorMap, Beam, BeamRun, BeamSegment, Bearing, BearingSide, Body, CraigLink, CrankAxis, FourBar,
    JointKind, KinematicModel, LinkTerm, LinkageArm, LinkageStatics, PointLoad, Section, SegmentLength,
    StaticProperties,
};

const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];

/// Name, kind, a mm, alpha deg, d mm.
type Row = (&'static str, JointKind, f64, f64, f64);

const ROWS: [Row; 7] = [
    ("rail", JointKind::Prismatic, 0.0, 0.0, 0.0),
    ("waist", JointKind::Revolute, 0.0, -90.0, 626.0),
    ("shoulder", JointKind::Revolute, 250.0, -90.0, 0.0),
    ("elbow", JointKind::Revolute, 1350.0, 0.0, 0.0),
    ("telescope", JointKind::Prismatic, 246.0, -90.0, 0.0),
    ("roll", JointKind::Revolute, 0.0, 0.0, 0.0),
    ("wrist", JointKind::Revolute, 0.0, 90.0, 0.0),
];

/// Mass kg, centre of mass m, moments of inertia about the link's axes kg m² (Ixx, Iyy, Izz), product Ixy.
const BODIES: [(f64, [f64; 3], [f64; 3], f64); 7] = [
    (800.0, [0.02, 0.28, 0.06], [90.0, 120.0, 80.0], 4.0),
    (400.0, [0.10, 0.02, -0.15], [30.0, 34.0, 28.0], 2.0),
    (250.0, [0.62, 0.03, 0.10], [6.0, 48.0, 50.0], -1.5),
    (150.0, [0.21, 0.55, 0.02], [28.0, 5.0, 29.0], 1.0),
    (80.0, [0.01, 0.02, -0.85], [24.0, 24.0, 1.2], 0.1),
    (25.0, [0.01, 0.0, -0.06], [0.30, 0.28, 0.20], 0.01),
    (15.0, [0.05, 0.07, 0.10], [0.25, 0.22, 0.16], -0.02),
];

/// N/m for the rail and the telescope, N m/rad for the rest: the tool droops by 10 to 15 mm.
const STIFFNESS: [f64; 7] = [5e7, 1.5e6, 8e5, 7e5, 5e6, 2.5e5, 1.2e5];

/// The robot without errors.
pub(super) fn spray_robot() -> AsBuilt {
    let links = ROWS.iter().map(|&(name, kind, a_mm, alpha_deg, d_mm)| CraigLink {
        name: name.to_owned(),
        kind,
        a: a_mm * 1e-3,
        alpha: alpha_deg.to_radians(),
        beta: 0.0,
        d: d_mm * 1e-3,
        theta: 0.0,
        limits: [-10.0, 10.0],
    });
    let bodies = BODIES.iter().map(|&(mass, centre, moments, product)| {
        let mut inertia = Matrix3::from_diagonal(&Vector3::from(moments));
        inertia[(0, 1)] = product;
        inertia[(1, 0)] = product;
        Body { mass, centre_of_mass: Vector3::from(centre), inertia }
    });
    AsBuilt {
        kinematics: KinematicModel {
            links: links.collect(),
            base_from_first: Transform::identity(),
            last_from_flange: Transform::identity(),
        },
        actuators: ActuatorMap::Direct,
        statics: StaticProperties::of_drives(
            bodies.collect(),
            STIFFNESS.to_vec(),
            Vector3::new(0.0, -9.80665, 0.0),
        ),
        target: Vector3::new(0.10, 0.15, 0.20),
        effects: Effects::default(),
    }
}

/// Six-axis bearings: N/m across the rail and the telescope, N m/rad about.
const BEARINGS: [[f64; 6]; 7] = [
    [4e8, 3e8, 0.0, 3e7, 4e7, 2e7],
    [1e9, 1e9, 8e8, 1.2e7, 1.1e7, 0.0],
    [6e8, 6e8, 5e8, 6e6, 7e6, 0.0],
    [5e8, 5e8, 4e8, 4e6, 5e6, 0.0],
    [2e8, 1.5e8, 0.0, 3e6, 2.5e6, 8e5],
    [2e8, 2e8, 1e8, 6e5, 5e5, 0.0],
    [1e8, 1e8, 8e7, 3e5, 4e5, 0.0],
];

/// The robot without errors, with all that yields: drives, six-axis bearings, upper arm and telescope as beams, and the elbow's four-bar;
/// it carries a gun and pulls a hose. 56 springs and the loop.
pub(super) fn full_robot() -> AsBuilt {
    let mut robot = spray_robot();
    let arm = LinkageArm { length: 0.35, angle: std::f64::consts::FRAC_PI_2, along: 0.0 };
    let linkage = FourBar { crank: arm, lever: arm, rod: 1.35, axis: CrankAxis::default() };
    robot.actuators =
        ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.0, linkage: Some(linkage) };
    let statics = &mut robot.statics;
    for (bearing, stiffness) in statics.bearings.iter_mut().zip(BEARINGS) {
        bearing.stiffness = stiffness;
    }
    statics.bearings[1].at = -0.2;
    statics.bearings[4] = Bearing { stiffness: BEARINGS[4], side: BearingSide::Fixed, at: 0.6 };
    let upper_arm = Section {
        axial: 1.2e9,
        shear: [2.0e8, 1.6e8],
        torsion: 3e6,
        bending: [5e6, 9e6],
        mass_per_length: 60.0,
    };
    let tube = Section {
        axial: 6e8,
        shear: [9e7, 9e7],
        torsion: 9e5,
        bending: [1.2e6, 1.3e6],
        mass_per_length: 20.0,
    };
    let segment = |length, section| vec![BeamSegment { length, section }];
    statics.beams[2] =
        Some(Beam { run: BeamRun::AlongX, segments: segment(SegmentLength::Constant(1.35), upper_arm) });
    statics.beams[4] =
        Some(Beam { run: BeamRun::EndsAtOrigin, segments: segment(SegmentLength::Extension(0.5), tube) });
    let crank = Body {
        mass: 20.0,
        centre_of_mass: Vector3::new(0.01, 0.12, 0.02),
        inertia: Matrix3::from_diagonal(&Vector3::new(0.3, 0.1, 0.35)),
    };
    statics.linkage = Some(LinkageStatics { rod_stiffness: 6e7, rod_mass: 18.0, crank });
    statics.loads = vec![
        PointLoad {
            name: "gun".to_owned(),
            link: 6,
            at: Vector3::new(0.05, 0.08, 0.12),
            mass: 4.0,
            force: Vector3::zeros(),
        },
        PointLoad {
            name: "hose".to_owned(),
            link: 6,
            at: Vector3::new(-0.02, 0.0, 0.05),
            mass: 0.0,
            force: Vector3::new(30.0, -40.0, 15.0),
        },
    ];
    robot
}

/// The command that takes the ideal full robot to a pose in the working region.
pub(super) fn working_command(robot: &AsBuilt, rng: &mut impl RngExt) -> Vec<f64> {
    robot.actuators.command_from_joints(&working_pose(rng))
}

/// Adds errors of up to 20 mm and 0.02 rad to every link parameter.
pub(super) fn add_errors(robot: &mut AsBuilt, rng: &mut impl RngExt) {
    for link in &mut robot.kinematics.links {
        for term in [LinkTerm::A, LinkTerm::Alpha, LinkTerm::Beta, LinkTerm::D, LinkTerm::Theta] {
            *link.term_mut(term) += rng.random_range(-0.02..0.02);
        }
    }
}

/// A command in the working region.
pub(super) fn working_pose(rng: &mut impl RngExt) -> Vec<f64> {
    CENTRE
        .iter()
        .zip(HALF_WIDTH)
        .map(|(centre, width)| centre + width * rng.random_range(-1.0..1.0))
        .collect()
}
