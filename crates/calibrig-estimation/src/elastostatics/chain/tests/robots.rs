//! Random elastic robots, and one like the spray painter.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use calibrig_model::geometry::{rotation_x, rotation_z, translation};
use calibrig_model::{
    ActuatorMap, AxisMap, Beam, BeamRun, BeamSegment, Bearing, BearingSide, Body, CalibrationModel,
    CraigLink, CrankAxis, FourBar, JointKind, KinematicModel, LinkageArm, LinkageStatics, PointLoad, Section,
    SegmentLength, StaticProperties,
};

pub(super) struct Case {
    pub model: CalibrationModel,
    pub command: Vec<f64>,
    pub in_flange: Vector3<f64>,
}

pub(super) struct Draw(ChaCha8Rng);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0.random_range(low..high)
    }

    fn vector(&mut self, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| self.within(-size, size))
    }

    fn chance(&mut self, of: f64) -> bool {
        self.within(0.0, 1.0) < of
    }

    /// Between 10^low and 10^high.
    fn power(&mut self, low: f64, high: f64) -> f64 {
        10_f64.powf(self.within(low, high))
    }

    fn six(&mut self, rigid: f64) -> [f64; 6] {
        std::array::from_fn(|c| match (self.chance(rigid), c < 3) {
            (true, _) => f64::INFINITY,
            (false, true) => self.power(6.7, 8.0),
            (false, false) => self.power(5.5, 6.5),
        })
    }

    fn bearing(&mut self) -> Bearing {
        let side = if self.chance(0.5) { BearingSide::Fixed } else { BearingSide::Moving };
        let at = if self.chance(0.5) { self.within(-0.3, 0.3) } else { 0.0 };
        Bearing { stiffness: self.six(0.4), side, at }
    }

    fn section(&mut self) -> Section {
        Section {
            axial: self.power(8.0, 9.0),
            shear: [self.power(7.5, 8.5), self.power(7.5, 8.5)],
            torsion: self.power(5.5, 6.5),
            bending: [self.power(5.5, 6.5), self.power(5.5, 6.5)],
            mass_per_length: self.within(1.0, 10.0),
        }
    }

    fn beam(&mut self, telescope: bool) -> Beam {
        let mut segments: Vec<_> = (0..if self.chance(0.5) { 1 } else { 2 })
            .map(|_| BeamSegment {
                length: SegmentLength::Constant(self.within(0.2, 0.5)),
                section: self.section(),
            })
            .collect();
        if telescope {
            segments[0].length = SegmentLength::Extension(0.3);
        }
        let run = if telescope || self.chance(0.5) { BeamRun::EndsAtOrigin } else { BeamRun::AlongX };
        Beam { run, segments }
    }

    fn body(&mut self) -> Body {
        Body { mass: self.within(15.0, 40.0), centre_of_mass: self.vector(0.4), inertia: Matrix3::identity() }
    }

    fn link(&mut self, kind: JointKind) -> CraigLink {
        CraigLink {
            name: String::new(),
            kind,
            a: self.within(-0.8, 0.8),
            alpha: self.within(-3.0, 3.0),
            beta: self.within(-0.3, 0.3),
            d: self.within(-0.8, 0.8),
            theta: self.within(-3.0, 3.0),
            limits: [-10.0, 10.0],
        }
    }

    fn drive(&mut self, kind: JointKind) -> f64 {
        match kind {
            JointKind::Prismatic => self.power(6.5, 7.5),
            JointKind::Revolute => self.power(5.5, 6.5),
        }
    }
}

fn mounted(links: Vec<CraigLink>) -> KinematicModel {
    KinematicModel {
        links,
        base_from_first: translation(0.02, -0.01, 0.03) * rotation_x(0.04),
        last_from_flange: translation(0.0, 0.01, 0.02),
    }
}

/// Axes that are shown the other way round, in other units, from another zero, and against the axis before.
fn axes(joints: usize) -> AxisMap {
    let shown = DMatrix::from_fn(joints, joints, |axis, actuator| match (axis, actuator) {
        _ if axis == actuator => [-1.0, 1.0, 2.0][axis % 3],
        _ if axis == actuator + 1 => -0.5,
        _ => 0.0,
    });
    AxisMap::new(shown, DVector::from_fn(joints, |axis, _| 0.1 * axis as f64)).expect("lower triangular")
}

/// A serial robot with bearings, beams and loads of all kinds; every third has the ideal parallelogram.
pub(super) fn serial(seed: u8) -> Case {
    let mut draw = Draw::new(u64::from(seed));
    let joints = 3 + usize::from(seed % 4);
    let parallelogram = seed % 3 == 1;
    let kinds: Vec<_> = (0..joints)
        .map(|i| {
            let prismatic = draw.chance(0.35) && !(parallelogram && (i == 1 || i == 2));
            if prismatic { JointKind::Prismatic } else { JointKind::Revolute }
        })
        .collect();
    let links: Vec<_> = kinds.iter().map(|kind| draw.link(*kind)).collect();
    let statics = StaticProperties {
        bodies: kinds.iter().map(|_| draw.body()).collect(),
        drive_stiffness: kinds.iter().map(|kind| draw.drive(*kind)).collect(),
        bearings: kinds.iter().map(|_| draw.bearing()).collect(),
        beams: kinds
            .iter()
            .map(|kind| draw.chance(0.6).then(|| draw.beam(*kind == JointKind::Prismatic)))
            .collect(),
        linkage: None,
        loads: (0..2)
            .map(|i| PointLoad {
                name: String::new(),
                link: joints - 1 - i,
                at: draw.vector(0.3),
                mass: draw.within(0.0, 10.0),
                force: draw.vector(100.0),
            })
            .collect(),
        gravity: draw.vector(8.0),
    };
    let actuators = if parallelogram {
        ActuatorMap::Parallelogram { shoulder: 1, elbow: 2, offset: 0.2, linkage: None }
    } else if joints > 1 {
        ActuatorMap::Axes { axes: axes(joints), elbow: None }
    } else {
        ActuatorMap::Direct
    };
    let command: Vec<f64> = kinds
        .iter()
        .map(|kind| match kind {
            JointKind::Prismatic => draw.within(0.5, 1.0),
            JointKind::Revolute => draw.within(-1.5, 1.5),
        })
        .collect();
    let command = match &actuators {
        ActuatorMap::Axes { .. } => actuators.command_from_joints(&command),
        _ => command,
    };
    Case {
        model: CalibrationModel {
            kinematics: KinematicModel {
                links,
                base_from_first: translation(0.3, -0.4, 0.1) * rotation_z(0.7) * rotation_x(-0.6),
                last_from_flange: translation(0.1, -0.2, 0.05) * rotation_x(0.4),
            },
            actuators,
            statics: Some(statics),
            motor_turns: vec![None; joints],
            spans: Vec::new(),
        },
        command,
        in_flange: draw.vector(0.3),
    }
}

const ROWS: [(JointKind, f64, f64, f64); 7] = [
    (JointKind::Prismatic, 0.0, 0.0, 0.0),
    (JointKind::Revolute, 0.0, -90.0, 0.626),
    (JointKind::Revolute, 0.25, -90.0, 0.0),
    (JointKind::Revolute, 1.35, 0.0, 0.0),
    (JointKind::Prismatic, 0.246, -90.0, 0.0),
    (JointKind::Revolute, 0.0, 0.0, 0.0),
    (JointKind::Revolute, 0.0, 90.0, 0.0),
];
const CENTRE: [f64; 7] = [2.0, 0.19, -1.71, 0.12, 2.0, -0.16, -0.77];
const HALF_WIDTH: [f64; 7] = [1.92, 0.39, 0.31, 0.20, 0.30, 1.18, 0.57];
const MASSES: [f64; 7] = [800.0, 400.0, 250.0, 150.0, 80.0, 25.0, 15.0];
const CENTRES: [[f64; 3]; 7] = [
    [0.02, 0.28, 0.06],
    [0.10, 0.02, -0.15],
    [0.62, 0.03, 0.10],
    [0.21, 0.55, 0.02],
    [0.01, 0.02, -0.85],
    [0.01, 0.0, -0.06],
    [0.05, 0.07, 0.10],
];
const DRIVES: [f64; 7] = [2.0e7, 1.5e6, 6.5e5, 4.6e5, 1.0e7, 1.0e5, 5.0e4];

/// A robot like the spray painter, elastic everywhere, with an imperfect four-bar and perturbed links.
pub(super) fn painter(seed: u8) -> Case {
    let mut draw = Draw::new(1000 + u64::from(seed));
    let links: Vec<_> = ROWS
        .iter()
        .map(|&(kind, a, alpha, d)| CraigLink {
            name: String::new(),
            kind,
            a: a + draw.within(-0.01, 0.01),
            alpha: alpha.to_radians() + draw.within(-0.01, 0.01),
            beta: draw.within(-0.01, 0.01),
            d: d + draw.within(-0.01, 0.01),
            theta: draw.within(-0.01, 0.01),
            limits: [-10.0, 10.0],
        })
        .collect();
    let bodies = MASSES.iter().zip(CENTRES).map(|(mass, centre)| Body {
        mass: *mass,
        centre_of_mass: Vector3::from(centre),
        inertia: Matrix3::identity(),
    });
    let bearings = ROWS.iter().enumerate().map(|(i, (kind, ..))| Bearing {
        stiffness: [2e8, 3e8, 2.5e8, 8e6, 6e6, 7e6],
        side: if *kind == JointKind::Prismatic || i == 2 && seed.is_multiple_of(2) {
            BearingSide::Fixed
        } else {
            BearingSide::Moving
        },
        at: if i == 2 { 0.1 } else { 0.0 },
    });
    let section = |bending: f64, mass_per_length| Section {
        axial: 5e8,
        shear: [1e8, 1.2e8],
        torsion: 0.7 * bending,
        bending: [bending, 1.3 * bending],
        mass_per_length,
    };
    let mut beams = vec![None; 7];
    beams[2] = Some(Beam {
        run: BeamRun::AlongX,
        segments: vec![
            BeamSegment { length: SegmentLength::Constant(0.65), section: section(2e7, 80.0) },
            BeamSegment { length: SegmentLength::Constant(0.70), section: section(1.5e7, 60.0) },
        ],
    });
    beams[4] = Some(Beam {
        run: BeamRun::EndsAtOrigin,
        segments: vec![BeamSegment { length: SegmentLength::Extension(1.2), section: section(5e6, 25.0) }],
    });
    let arm = |length, angle, along| LinkageArm { length, angle, along };
    let linkage = FourBar {
        crank: arm(0.35 + draw.within(-0.01, 0.01), -1.5, 0.1),
        lever: arm(0.35 + draw.within(-0.01, 0.01), -1.5, 0.12),
        rod: 1.35 + draw.within(-0.01, 0.01),
        axis: CrankAxis { x: 0.008, y: -0.006, rx: 0.01, ry: -0.015 },
    };
    let statics = StaticProperties {
        bodies: bodies.collect(),
        drive_stiffness: DRIVES.to_vec(),
        bearings: bearings.collect(),
        beams,
        linkage: Some(LinkageStatics {
            rod_stiffness: 3e7,
            rod_mass: 20.0,
            crank: Body {
                mass: 30.0,
                centre_of_mass: Vector3::new(0.02, -0.15, 0.03),
                inertia: Matrix3::identity(),
            },
        }),
        loads: vec![
            PointLoad {
                name: String::new(),
                link: 6,
                at: Vector3::new(0.05, 0.1, 0.1),
                mass: 8.0,
                force: Vector3::new(20.0, -10.0, 30.0),
            },
            PointLoad {
                name: String::new(),
                link: 3,
                at: Vector3::new(0.2, 0.3, 0.0),
                mass: 12.0,
                force: Vector3::zeros(),
            },
        ],
        gravity: Vector3::new(0.05, -9.80665, 0.03),
    };
    let actuators =
        ActuatorMap::Parallelogram { shoulder: 2, elbow: 3, offset: 0.03, linkage: Some(linkage) };
    let joints: Vec<_> = CENTRE.iter().zip(HALF_WIDTH).map(|(c, w)| c + w * draw.within(-1.0, 1.0)).collect();
    Case {
        command: actuators.command_from_joints(&joints),
        model: CalibrationModel {
            kinematics: mounted(links),
            actuators,
            statics: Some(statics),
            motor_turns: vec![None; 7],
            spans: Vec::new(),
        },
        in_flange: Vector3::new(0.10, 0.15, 0.20),
    }
}
