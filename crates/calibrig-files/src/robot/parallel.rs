//! Tables of nearly parallel axes whose common normal is far away.
//!
//! If neighbouring axes enclose a small angle, their common normal can be anywhere: the D-H rows of a calibrated robot may then go some
//! hundred metres out along one axis and back along the next, and no manufacturing error is small in them. Hayati's beta describes the same
//! axes by the point where the second one meets a plane across the first (S. Hayati, "Robot arm geometric link parameter estimation", 1983).

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use nalgebra::{Rotation3, Vector3};

use calibrig_model::geometry::{Transform, rotation_x, rotation_y, rotation_z, translation};
use calibrig_model::{CraigLink, JointKind, KinematicModel};

/// Axes that enclose less are nearly parallel, rad.
const NEARLY_PARALLEL: f64 = 0.05;

/// Rewrites every run of nearly parallel revolute axes in which an offset d is longer than the whole robot with its runs rewritten. The
/// chain is the same to rounding, and so are all frames except those of a run's links before its last. Returns which links were
/// rewritten.
pub(super) fn rewrite_far_normals(chain: &mut KinematicModel) -> Vec<Range<usize>> {
    let runs = runs(&chain.links);
    let mut near = chain.clone();
    for run in &runs {
        rewrite(&mut near.links, run);
    }
    let reach = near.characteristic_length();
    let is_far = |run: &Range<usize>| chain.links[run.clone()].iter().any(|link| link.d.abs() > reach);
    let far: Vec<_> = runs.into_iter().filter(is_far).collect();
    for run in &far {
        rewrite(&mut chain.links, run);
    }
    far
}

/// Links whose axes are each nearly parallel to the one before, two or more in a row.
fn runs(links: &[CraigLink]) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for row in 1..links.len() {
        let (before, link) = (&links[row - 1], &links[row]);
        let cosine = link.alpha.cos() * link.beta.cos();
        let turn = [before, link].iter().all(|link| link.kind == JointKind::Revolute);
        if !turn || cosine.abs() < NEARLY_PARALLEL.cos() {
            continue;
        }
        match runs.last_mut() {
            Some(run) if run.end == row => run.end = row + 1,
            _ => runs.push(row - 1..row + 1),
        }
    }
    runs
}

/// Places the origin of every link but the last where its axis meets the plane across the axis before at that one's origin; the first
/// stays without an offset.
fn rewrite(links: &mut [CraigLink], run: &Range<usize>) {
    for row in run.start + 1..run.end {
        let [before, link] = &mut links[row - 1..=row] else { return };
        // From behind the first joint's motion to behind the second's fixed part.
        let second_from: Transform =
            rotation_z(before.theta) * translation(0.0, 0.0, before.d) * link.fixed_part();
        let (place, axis) = (second_from.translation.vector, second_from.rotation * Vector3::z());
        let along = place.z / axis.z;
        let met = place - along * axis;
        let theta = plane_angle(&met, before.theta);
        let towards = rotation_z(-theta).rotation;
        let axis = towards * axis;
        let twist: Transform =
            rotation_z(theta) * rotation_x((-axis.y).atan2(axis.z)) * rotation_y(axis.x.asin());
        let left: Rotation3<f64> = twist.rotation.inverse() * second_from.rotation;
        (before.theta, before.d) = (theta, 0.0);
        link.a = (towards * met).x;
        link.alpha = (-axis.y).atan2(axis.z);
        link.beta = axis.x.asin();
        link.theta = left.matrix().m21.atan2(left.matrix().m11);
        link.d = along;
    }
}

/// The angle about z of the line from the origin to a point, within a quarter turn; `otherwise` if the point is the origin.
fn plane_angle(point: &Vector3<f64>, otherwise: f64) -> f64 {
    if point.xy().norm() < 1e-9 {
        return otherwise;
    }
    let angle = point.y.atan2(point.x);
    if angle > FRAC_PI_2 {
        angle - 2.0 * FRAC_PI_2
    } else if angle <= -FRAC_PI_2 {
        angle + 2.0 * FRAC_PI_2
    } else {
        angle
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use rand::RngExt;

    use super::*;
    use calibrig_model::random::{StreamSource, stream};

    fn flange(chain: &KinematicModel, joints: &[f64]) -> Transform {
        let links = chain.links.iter().zip(joints);
        links.fold(Transform::identity(), |at, (link, q)| at * link.transform(*q)) * chain.last_from_flange
    }

    /// The classic rows, with the common normal wherever it is, of axes given by a point and a direction each.
    fn classic(axes: &[(Vector3<f64>, Vector3<f64>)]) -> KinematicModel {
        let mut frame = Transform::identity();
        let mut links: Vec<CraigLink> = Vec::new();
        for (i, (point, direction)) in axes.iter().enumerate() {
            let (origin, before) = (frame.translation.vector, frame.rotation * Vector3::z());
            // The feet of the common normal.
            let normal = before.cross(direction);
            let between = point - origin;
            let along = between.cross(direction).dot(&normal) / normal.norm_squared();
            let foot = origin + along * before;
            let x = normal.normalize();
            let in_frame = frame.rotation.inverse() * x;
            let turn = in_frame.y.atan2(in_frame.x);
            if let Some(last) = links.last_mut() {
                (last.theta, last.d) = (last.theta + turn, last.d + along);
            } else {
                frame *= rotation_z(turn) * translation(0.0, 0.0, along);
            }
            let a = (point - foot).dot(&x);
            let alpha = normal.dot(&x).atan2(before.dot(direction));
            let link = CraigLink::revolute(format!("j{i}")).row(a, alpha, 0.0, 0.0);
            if i > 0 {
                frame *= rotation_z(turn) * translation(0.0, 0.0, along);
            }
            frame *= link.fixed_part();
            links.push(link);
        }
        // The flange is at the last axis's point.
        if let (Some(last), Some((point, direction))) = (links.last_mut(), axes.last()) {
            last.d = (point - frame.translation.vector).dot(direction);
        }
        KinematicModel::new(links).expect("a chain")
    }

    /// Axes of a robot, of which each of `parallel` is parallel to the one before, one way or the other, but for some tenths of a mrad.
    fn axes(parallel: &[usize], number: u32) -> Vec<(Vector3<f64>, Vector3<f64>)> {
        let mut random = stream(3, number, StreamSource::AsBuilt);
        let mut vector = |size: f64| Vector3::from_fn(|_, _| random.random_range(-size..size));
        let mut axes = vec![(vector(0.5), vector(1.0).normalize())];
        for i in 1..6 {
            let sign = if (i + number as usize).is_multiple_of(2) { 1.0 } else { -1.0 };
            let direction =
                if parallel.contains(&i) { sign * axes[i - 1].1 + vector(5e-4) } else { vector(1.0) };
            axes.push((axes[i - 1].0 + vector(0.5), direction.normalize()));
        }
        axes
    }

    #[test]
    fn far_normals_come_near_and_the_chain_is_the_same() {
        for (number, parallel) in
            [(0, vec![1]), (1, vec![2, 3]), (2, vec![5]), (3, vec![1, 2, 3]), (4, vec![2, 4, 5])]
        {
            let far = classic(&axes(&parallel, number));
            assert!(far.links.iter().any(|link| link.d.abs() > 50.0), "{far:?}");
            let mut near = far.clone();
            let rewritten = rewrite_far_normals(&mut near);
            let rows: Vec<usize> = rewritten.into_iter().flat_map(|run| run.start + 1..run.end).collect();
            assert_eq!(rows, parallel);
            for link in &near.links {
                assert!(link.d.abs() < 10.0 && link.a.abs() < 10.0, "{link:?}");
            }
            let mut random = stream(4, number, StreamSource::AsBuilt);
            for _ in 0..50 {
                let joints: Vec<f64> = (0..6).map(|_| random.random_range(-PI..PI)).collect();
                let [one, other] = [&far, &near].map(|chain| flange(chain, &joints));
                let point = Vector3::new(0.1, 0.2, 0.3).into();
                let apart = (one.transform_point(&point) - other.transform_point(&point)).norm();
                assert!(apart < 1e-10, "{apart}");
            }
        }
    }

    #[test]
    fn what_is_near_stays_as_it_is() {
        let offset = |i: usize| {
            CraigLink::revolute(format!("j{i}")).row(0.4, 0.0, if i == 1 { 0.8 } else { -0.8 }, 0.3)
        };
        let exact = KinematicModel::new((0..4).map(offset).collect()).expect("a chain");
        let mut same = exact.clone();
        assert!(rewrite_far_normals(&mut same).is_empty());
        assert_eq!(same, exact);
        // Far, but not parallel; and parallel, but a slide.
        let mut links: Vec<_> = (0..3).map(offset).collect();
        (links[1].d, links[2].alpha) = (500.0, 1.2);
        links.push(CraigLink::prismatic("slide").row(0.1, 1e-3, 500.0, 0.0).limits(0.0, 1.0));
        let crossed = KinematicModel::new(links).expect("a chain");
        let mut same = crossed.clone();
        assert!(rewrite_far_normals(&mut same).is_empty());
        assert_eq!(same, crossed);
    }
}
