//! What a chain keeps, takes over and refuses.

use super::robots::{painter, serial};
use crate::elastostatics::{Deflection, ElasticChain, ElasticError};
use crate::kinematics::{forward_kinematics, joints_from_command};
use calibrig_model::{
    ActuatorMap, Compliance, CrankAxis, LinkTerm, LinkageTerm, ModelError, ParameterId, Payload,
    PayloadError, PointLoad, TermPlace,
};
use nalgebra::{Point3, Vector3};

#[test]
fn a_rigid_chain_is_the_product_of_the_link_transforms() {
    for case in (0..6).map(serial).chain((0..6).map(painter)) {
        let model = &case.model;
        let mut q = case.command.clone();
        joints_from_command(&model.kinematics, &model.actuators, &case.command, &mut q).expect("closes");
        let product = forward_kinematics(&model.kinematics, &q).expect("a pose");
        let mut bare = model.clone();
        bare.statics = None;
        let mut made_rigid = model.clone();
        made_rigid.statics.as_mut().expect("statics").make_rigid();
        for (model, deflection) in [
            (model, Deflection::None),
            (&bare, Deflection::Equilibrium),
            (&made_rigid, Deflection::Equilibrium),
        ] {
            let mut chain = ElasticChain::of(model);
            chain.settle(&case.command, &[], deflection).expect("a pose");
            let difference = chain.base_from_flange().to_homogeneous() - product.to_homogeneous();
            assert!(difference.norm() < 1e-12, "{difference}");
            assert_eq!(chain.link_frames().len(), q.len());
        }
    }
}

#[test]
fn a_pose_does_not_depend_on_the_poses_before_it() {
    let (case, other) = (painter(0), painter(1));
    let corrections = [(TermPlace::Frame { joint: 4, component: 3 }, 0.01)];
    let mut chain = ElasticChain::of(&case.model);
    let mut evaluate = |command: &[f64], corrections: &[(TermPlace, f64)]| {
        chain.settle(command, corrections, Deflection::Equilibrium).expect("rest");
        chain.prepare(&case.in_flange).expect("stable");
        let column = chain.change(ParameterId::link(3, LinkTerm::Beta));
        [chain.target(&case.in_flange), column].map(|v| v.map(f64::to_bits))
    };
    let first = evaluate(&case.command, &[]);
    evaluate(&other.command, &corrections);
    assert_eq!(evaluate(&case.command, &[]), first);
}

#[test]
fn a_model_with_statics_does_not_replace_one_without_them() {
    let case = serial(0);
    let mut bare = case.model.clone();
    bare.statics = None;
    for (reference, other) in [(&case.model, &bare), (&bare, &case.model)] {
        let mut chain = ElasticChain::of(reference);
        assert_eq!(chain.set_model(other), Err(ModelError::Structure { field: "statics" }));
        assert_eq!(chain.set_model(reference), Ok(()));
    }
}

#[test]
fn given_deflections_reproduce_the_pose() {
    for case in [serial(0), serial(1), painter(0), painter(1)] {
        let mut chain = ElasticChain::of(&case.model);
        chain.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
        let (at_rest, deflections) = (chain.target(&case.in_flange), chain.deflections().to_vec());
        let mut frozen = ElasticChain::of(&case.model);
        frozen.settle_at(&case.command, &[], &deflections).expect("a pose");
        assert!((frozen.target(&case.in_flange) - at_rest).norm() < 1e-12);
        assert_eq!(frozen.deflections(), deflections);
    }
}

/// An exact parallelogram, so that the real and the ideal map differ by deflection alone.
#[test]
fn deflections_of_a_four_bar_bend_a_chain_with_the_ideal_map() {
    let mut case = painter(0);
    for link in 2..4 {
        let link = &mut case.model.kinematics.links[link];
        (link.beta, link.theta) = (0.0, 0.0);
    }
    let elbow = &mut case.model.kinematics.links[3];
    (elbow.alpha, elbow.d) = (0.0, 0.0);
    let a = elbow.a;
    let ActuatorMap::Parallelogram { linkage: Some(linkage), .. } = &mut case.model.actuators else {
        panic!("a four-bar");
    };
    (linkage.rod, linkage.lever, linkage.axis) = (a, linkage.crank, CrankAxis::default());
    let mut with_loop = ElasticChain::of(&case.model);
    with_loop.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
    let mut ideal = case.model.clone();
    if let ActuatorMap::Parallelogram { linkage, .. } = &mut ideal.actuators {
        *linkage = None;
    }
    let mut ideal = ElasticChain::of(&ideal);
    ideal.settle_at(&case.command, &[], with_loop.deflections()).expect("a pose");
    let [expected, found] = [&with_loop, &ideal].map(|chain| chain.target(&case.in_flange));
    assert!((expected - found).norm() < 1e-12, "{expected} {found}");
}

#[test]
fn poses_take_no_memory() {
    let case = painter(0);
    let mut chain = ElasticChain::of(&case.model);
    let corrections = [(TermPlace::Actuator(3), 1e-3)];
    let info = allocation_counter::measure(|| {
        chain.take(&case.model);
        chain.settle(&case.command, &corrections, Deflection::Equilibrium).expect("rest");
        chain.prepare(&case.in_flange).expect("stable");
        let sum = chain.change(ParameterId::link(2, LinkTerm::Alpha))
            + chain.change(ParameterId::Compliance(Compliance::Beam { link: 4 }))
            + chain.change(ParameterId::Mass { link: 4 })
            + chain.change(ParameterId::Linkage(LinkageTerm::Lever))
            + chain.change_of_place(TermPlace::Actuator(2));
        assert!(sum.norm() > 0.0);
    });
    assert_eq!(info.count_total, 0);
}

#[test]
fn what_has_no_rest_is_refused() {
    let mut soft = serial(0);
    soft.model.statics.as_mut().expect("statics").drive_stiffness.fill(10.0);
    let refusal =
        ElasticChain::of(&soft.model).settle(&soft.command, &[], Deflection::Equilibrium).unwrap_err();
    assert!(matches!(refusal, ElasticError::NotSettled { residual, .. } if !(residual < 1e-3)), "{refusal}");

    let mut housed = painter(0);
    housed.command[4] = 1.1;
    let refusal = ElasticChain::of(&housed.model).settle(&housed.command, &[], Deflection::None).unwrap_err();
    assert!(matches!(refusal, ElasticError::Housed { link: 4, length } if (length + 0.1).abs() < 1e-12));

    let mut open = painter(0);
    if let ActuatorMap::Parallelogram { linkage: Some(linkage), .. } = &mut open.model.actuators {
        linkage.rod = 3.0;
    }
    let refusal = ElasticChain::of(&open.model).settle(&open.command, &[], Deflection::None).unwrap_err();
    assert!(matches!(refusal, ElasticError::Linkage(_)), "{refusal}");
}

/// A payload is what a load of the last link is, for as long as it hangs there, in any pose and of any map of the elbow.
#[test]
fn a_payload_is_a_load_of_the_last_link() {
    let payload = Payload {
        name: "plates".to_owned(),
        mass: 40.0,
        centre: Vector3::new(0.02, 0.05, 0.15),
        force: Vector3::new(-30.0, 0.0, 90.0),
    };
    for case in (0..6).map(serial).chain((0..4).map(painter)) {
        let mut with_load = case.model.clone();
        let last_from_flange = case.model.kinematics.last_from_flange;
        with_load.statics.as_mut().expect("statics").loads.push(PointLoad {
            name: payload.name.clone(),
            link: case.command.len() - 1,
            at: (last_from_flange * Point3::from(payload.centre)).coords,
            mass: payload.mass,
            force: payload.force,
        });
        let target = |chain: &mut ElasticChain| {
            chain.settle(&case.command, &[], Deflection::Equilibrium).expect("rest");
            chain.target(&case.in_flange)
        };
        let expected = target(&mut ElasticChain::of(&with_load));
        let mut chain = ElasticChain::of(&case.model);
        let unloaded = target(&mut chain);
        chain.set_payload(Some(&payload)).expect("sound");
        let loaded = target(&mut chain);
        assert!((loaded - expected).amax() < 1e-12, "{loaded} {expected}");
        assert!((loaded - unloaded).amax() > 1e-5, "{loaded} {unloaded}");
        chain.set_payload(None).expect("nothing");
        assert_eq!(target(&mut chain).map(f64::to_bits), unloaded.map(f64::to_bits));
        let negative = Payload { mass: -1.0, ..payload.clone() };
        assert!(matches!(chain.set_payload(Some(&negative)), Err(PayloadError::Mass { .. })));
        assert_eq!(target(&mut chain).map(f64::to_bits), unloaded.map(f64::to_bits));
    }
}
