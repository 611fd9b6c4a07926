//! Every column against the central difference of the settled position, and of the rotation of the flange.

use nalgebra::Vector3;

use super::robots::{Case, painter, serial};
use crate::elastostatics::{Deflection, ElasticChain, put};
use calibrig_model::geometry::rotation_vector;
use calibrig_model::{CalibrationModel, Compliance, LinkageTerm, ParameterId, Payload, TermPlace};

/// Corrections that are in place while columns are taken: the columns of corrections depend on their order, too.
const CORRECTIONS: [(TermPlace, f64); 4] = [
    (TermPlace::Frame { joint: 1, component: 1 }, 0.004),
    (TermPlace::Frame { joint: 1, component: 3 }, -0.006),
    (TermPlace::Frame { joint: 1, component: 4 }, 0.008),
    (TermPlace::Actuator(2), 0.003),
];

fn every_parameter(model: &CalibrationModel) -> Vec<ParameterId> {
    let joints = model.kinematics.joint_count();
    let mut ids = ParameterId::all_of_links(joints);
    ids.extend(ParameterId::all_of_target(0));
    for joint in 0..joints {
        ids.push(ParameterId::Mass { link: joint });
        ids.extend((0..3).map(|axis| ParameterId::Centre { link: joint, axis }));
        ids.push(ParameterId::Compliance(Compliance::Drive { joint }));
        ids.push(ParameterId::Compliance(Compliance::Beam { link: joint }));
        let bearing = |axis| ParameterId::Compliance(Compliance::Bearing { joint, axis });
        ids.extend((0..6).map(bearing));
    }
    ids.push(ParameterId::Compliance(Compliance::Rod));
    ids.extend(LinkageTerm::ALL.map(ParameterId::Linkage));
    ids
}

fn every_place(joints: usize) -> Vec<TermPlace> {
    let frame = |joint| (0..6).map(move |component| TermPlace::Frame { joint, component });
    (0..joints).map(TermPlace::Actuator).chain((0..joints).flat_map(frame)).collect()
}

struct Settler {
    chain: ElasticChain,
    reference: CalibrationModel,
    /// Values that are in place of the reference's.
    base: CalibrationModel,
    command: Vec<f64>,
    in_flange: Vector3<f64>,
    deflection: Deflection,
    frozen: Option<Vec<f64>>,
}

impl Settler {
    fn settle(&mut self, model: &CalibrationModel, more: Option<(TermPlace, f64)>) {
        let corrections: Vec<_> = CORRECTIONS.into_iter().chain(more).collect();
        self.chain.take(model);
        match &self.frozen {
            Some(u) => self.chain.settle_at(&self.command, &corrections, u).expect("a pose"),
            None => {
                let settled = self.chain.settle(&self.command, &corrections, self.deflection).expect("rest");
                assert!(settled.residual <= 1e-13);
            }
        }
    }

    /// Central difference of the fourth order, by a step of `h`.
    fn difference(
        &mut self,
        h: f64,
        set: impl Fn(&mut CalibrationModel, &mut Vector3<f64>, &mut Option<(TermPlace, f64)>, f64),
    ) -> [Vector3<f64>; 2] {
        let mut at = |by: f64| {
            let (mut model, mut target, mut place) = (self.base.clone(), self.in_flange, None);
            set(&mut model, &mut target, &mut place, by);
            self.settle(&model, place);
            (self.chain.target(&target), self.chain.base_from_flange().rotation)
        };
        let [near, far] = [h, 2.0 * h].map(|h| {
            let ((ahead, turned), (behind, from)) = (at(h), at(-h));
            [ahead - behind, rotation_vector(&(turned * from.inverse()))]
        });
        [0, 1].map(|kind| (8.0 * near[kind] - far[kind]) / (12.0 * h))
    }

    fn check(&mut self, base: impl Fn(ParameterId) -> f64, ids: &[ParameterId], what: &str) -> usize {
        self.base = self.reference.clone();
        for id in ids {
            put(&mut self.base, &self.reference, *id, base(*id));
        }
        let model = self.base.clone();
        self.settle(&model, None);
        self.chain.prepare(&self.in_flange).expect("a stable pose");
        let columns: Vec<_> = ids.iter().map(|id| self.chain.change(*id)).collect();
        let places = every_place(self.command.len());
        let place_columns: Vec<_> = places.iter().map(|p| self.chain.change_of_place(*p)).collect();
        self.chain.prepare_turn().expect("a stable pose");
        let turns: Vec<_> = ids.iter().map(|id| self.chain.change(*id)).collect();
        let place_turns: Vec<_> = places.iter().map(|p| self.chain.change_of_place(*p)).collect();
        let mut count = 0;
        for ((id, column), turn) in ids.iter().zip(&columns).zip(&turns) {
            let reference = self.reference.clone();
            let from = base(*id);
            // At x = -1 the difference reaches to negative compliances, which are compliances all the same.
            let h =
                if matches!(id, ParameterId::Compliance(_) | ParameterId::Mass { .. }) { 1e-2 } else { 1e-4 };
            let [difference, turned] = self.difference(h, |model, target, _, by| match *id {
                ParameterId::Target { axis, .. } => target[axis] += by,
                _ => put(model, &reference, *id, from + by),
            });
            compare(&format!("{what} {id}"), column, &difference);
            compare(&format!("{what} {id}, rotation"), turn, &turned);
            count += usize::from(column.amax() > 0.0);
        }
        for ((place, column), turn) in places.iter().zip(&place_columns).zip(&place_turns) {
            let [difference, turned] = self.difference(1e-4, |_, _, more, by| *more = Some((*place, by)));
            compare(&format!("{what} {place:?}"), column, &difference);
            compare(&format!("{what} {place:?}, rotation"), turn, &turned);
        }
        count
    }
}

fn compare(what: &str, column: &Vector3<f64>, difference: &Vector3<f64>) {
    let error = (column - difference).amax();
    // Positions are rounded to 1e-15 m, the difference by a step of 1e-4 to 1e-11.
    assert!(error <= 1e-6 * column.amax() + 1e-10, "{what}: {column:?} {difference:?}");
}

fn settler(case: Case, deflection: Deflection) -> (Settler, Vec<ParameterId>) {
    let ids = every_parameter(&case.model);
    let settler = Settler {
        chain: ElasticChain::of(&case.model),
        base: case.model.clone(),
        reference: case.model,
        command: case.command,
        in_flange: case.in_flange,
        deflection,
        frozen: None,
    };
    (settler, ids)
}

#[test]
fn columns_of_serial_robots_are_central_differences() {
    for seed in 0..12 {
        let (mut settler, ids) = settler(serial(seed), Deflection::Equilibrium);
        settler.check(|_| 0.0, &ids, &format!("serial {seed}"));
    }
}

#[test]
fn columns_of_painters_are_central_differences() {
    for seed in 0..4 {
        let (mut settler, ids) = settler(painter(seed), Deflection::Equilibrium);
        let excited = settler.check(|_| 0.0, &ids, &format!("painter {seed}"));
        assert!(excited > 90, "{excited}");
    }
}

/// Where compliances are nearly gone, and where they are: the columns still exist.
#[test]
fn columns_exist_where_a_compliance_vanishes() {
    for x in [-0.9, -1.0] {
        let base = |id| if matches!(id, ParameterId::Compliance(_)) { x } else { 0.0 };
        for case in [serial(1), serial(2), painter(1)] {
            let (mut settler, ids) = settler(case, Deflection::Equilibrium);
            settler.check(base, &ids, &format!("x = {x}"));
        }
    }
    let half = |id| match id {
        ParameterId::Mass { link } if link % 2 == 0 => -1.0,
        ParameterId::Mass { .. } => 0.3,
        ParameterId::Centre { .. } => 0.02,
        ParameterId::Linkage(_) => 0.002,
        _ => 0.0,
    };
    let (mut settler, ids) = settler(painter(2), Deflection::Equilibrium);
    settler.check(half, &ids, "masses");
}

#[test]
fn columns_of_rigid_and_of_frozen_chains_are_central_differences() {
    for case in [serial(3), serial(4), painter(0), painter(3)] {
        let mut chain = ElasticChain::of(&case.model);
        chain.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
        let (mut settler, ids) = settler(case, Deflection::None);
        settler.check(|_| 0.0, &ids, "rigid");
        settler.frozen = Some(chain.deflections().to_vec());
        settler.check(|_| 0.0, &ids, "frozen");
    }
}

/// What the flange carries loads every spring, and moves with every parameter.
#[test]
fn columns_of_loaded_robots_are_central_differences() {
    let payload = Payload {
        name: "gripper".to_owned(),
        mass: 30.0,
        centre: Vector3::new(0.05, -0.08, 0.2),
        force: Vector3::new(60.0, -80.0, 30.0),
    };
    for (name, case) in
        [("serial", serial(1)), ("serial", serial(2)), ("serial", serial(5)), ("painter", painter(0))]
    {
        let mut bare = ElasticChain::of(&case.model);
        let mut compliance_of_drive = |payload: Option<&Payload>| {
            bare.set_payload(payload).expect("sound");
            bare.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
            bare.prepare(&case.in_flange).expect("stable");
            bare.change(ParameterId::Compliance(Compliance::Drive { joint: 2 }))
        };
        let (unloaded, loaded) = (compliance_of_drive(None), compliance_of_drive(Some(&payload)));
        assert!(
            (loaded - unloaded).amax() > 1e-2 * unloaded.amax().max(loaded.amax()),
            "{name}: {loaded} {unloaded}"
        );
        let (mut settler, ids) = settler(case, Deflection::Equilibrium);
        settler.chain.set_payload(Some(&payload)).expect("sound");
        settler.check(|_| 0.0, &ids, &format!("loaded {name}"));
    }
}
