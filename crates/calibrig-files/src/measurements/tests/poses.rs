//! Files of full poses: every form of a rotation, both ways of the transform, what states an uncertainty, and what is refused.

use super::*;
use calibrig_model::geometry::rotation_vector;
use nalgebra::UnitQuaternion;

const CARTESIAN: &str =
    "[position]\nsystem = \"cartesian\"\nunit = \"mm\"\nx = \"x\"\ny = \"y\"\nz = \"z\"\n";

fn rotation_map(rotation: &str) -> String {
    format!("{CARTESIAN}[rotation]\ntransform = \"target_in_tracker\"\n{rotation}\n")
}

fn refused_map(text: &str) -> String {
    let head = "schema = \"calibrig.columns/1\"\n[joints]\ncolumns = [\"s\", \"t\"]\nrevolute_unit = \"deg\"\nprismatic_unit = \"mm\"\n";
    let error = parse_column_map(&Source::new("columns.toml", format!("{head}{text}"))).expect_err(text);
    drawn(error)
}

/// A refusal as it is drawn, on one line.
fn drawn(error: InputError) -> String {
    let drawn = format!("{:?}", miette::Report::new(error));
    drawn.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ")
}

fn pose_of(loaded: &LoadedMeasurements, index: usize) -> &PoseReading {
    match &loaded.set.observations[index].reading {
        Reading::Pose(pose) => pose,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_form_is_the_same_rotation() {
    let rotation = Rotation3::new(Vector3::new(0.4, -0.9, 1.3));
    let q = UnitQuaternion::from_rotation_matrix(&rotation);
    // Roll, pitch and yaw of nalgebra are about the fixed x, y and z.
    let (roll, pitch, yaw) = rotation.euler_angles();
    let v = rotation_vector(&rotation);
    let m = rotation.matrix();
    let text = |numbers: &[f64]| {
        let names: Vec<_> = (0..numbers.len()).map(|i| format!("c{i}")).collect();
        let cells: Vec<_> = numbers.iter().map(|number| format!("{number:?}")).collect();
        (format!("s,t,x,y,z,{}\n1,2,100,200,300,{}\n", names.join(","), cells.join(",")), names)
    };
    let degrees = |angles: [f64; 3]| angles.map(f64::to_degrees);
    let by_columns: Vec<f64> = m.iter().copied().collect();
    let by_rows: Vec<f64> = m.transpose().iter().copied().collect();
    for (form, numbers) in [
        ("form = \"quaternion\"\norder = \"wxyz\"", &[q.w, q.i, q.j, q.k][..]),
        ("form = \"quaternion\"\norder = \"xyzw\"", &[q.i, q.j, q.k, q.w]),
        ("form = \"abb_quaternion\"", &[-q.w, -q.i, -q.j, -q.k]),
        ("form = \"rotation_vector\"\nunit = \"rad\"", v.as_slice()),
        ("form = \"ur_rotation_vector\"\nunit = \"deg\"", &degrees(v.into())),
        ("form = \"euler\"\nsequence = \"xyz fixed\"\nunit = \"rad\"", &[roll, pitch, yaw]),
        ("form = \"euler\"\nsequence = \"zyx intrinsic\"\nunit = \"deg\"", &degrees([yaw, pitch, roll])),
        ("form = \"kuka_abc\"\nunit = \"deg\"", &degrees([yaw, pitch, roll])),
        ("form = \"fanuc_wpr\"\nunit = \"deg\"", &degrees([roll, pitch, yaw])),
        ("form = \"matrix\"\norder = \"rows\"", &by_rows),
        ("form = \"matrix\"\norder = \"columns\"", &by_columns),
    ] {
        let (file, names) = text(numbers);
        let map = map(&rotation_map(&format!("{form}\ncolumns = {names:?}")));
        let loaded = mapped(&file, &map).expect(form);
        let pose = pose_of(&loaded, 0);
        assert!((pose.rotation.matrix() - m).amax() < 1e-14, "{form}: {}", pose.rotation);
        assert!((pose.position - Vector3::new(0.1, 0.2, 0.3)).amax() < 1e-15, "{form}");
        assert_eq!(pose.covariance, None);
        assert!(loaded.remarks.is_empty(), "{:?}", loaded.remarks);
    }
}

/// The covariance of a pose that the file has the other way around, against differences of what the reader makes of moved numbers.
#[test]
fn a_pose_the_other_way_around_is_turned_with_its_uncertainty() {
    let rotation = "[rotation]\ntransform = \"tracker_in_target\"\nform = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]\n\
                    sigma = [\"sa\", \"sb\", \"sc\"]\nsigma_unit = \"mrad\"\nk = 2\n[sigma]\nunit = \"um\"\nx = \"sx\"\ny = \"sy\"\nz = \"sz\"\n";
    let map = map(&format!("{CARTESIAN}{rotation}"));
    let header = "s,t,x,y,z,a,b,c,sx,sy,sz,sa,sb,sc\n";
    let (position, turn) = (Vector3::new(0.7, -2.1, 1.4), Rotation3::new(Vector3::new(0.5, 1.1, -0.3)));
    let read = |position: Vector3<f64>, turn: Rotation3<f64>| {
        let (p, v) = (position * 1e3, rotation_vector(&turn));
        let row =
            format!("1,2,{:?},{:?},{:?},{:?},{:?},{:?},10,20,30,0.2,0.4,0.6\n", p.x, p.y, p.z, v.x, v.y, v.z);
        let loaded = mapped(&format!("{header}{row}"), &map).expect("valid");
        pose_of(&loaded, 0).clone()
    };
    let pose = read(position, turn);
    // tracker_in_target and target_in_tracker undo each other.
    assert!((pose.rotation * turn).angle() < 1e-7);
    assert!((turn * pose.position + position).amax() < 1e-14);
    let step = 1e-6;
    let mut jacobian = Matrix6::zeros();
    for axis in 0..6 {
        let moved = |sign: f64| {
            let mut by = Vector6::zeros();
            by[axis] = sign * step;
            let about = Rotation3::new(Vector3::new(by[3], by[4], by[5]));
            read(position + Vector3::new(by[0], by[1], by[2]), about * turn)
        };
        let (plus, minus) = (moved(1.0), moved(-1.0));
        let of_place = (plus.position - minus.position) / (2.0 * step);
        let of_turn = rotation_vector(&(plus.rotation * minus.rotation.inverse())) / (2.0 * step);
        jacobian.set_column(axis, &Vector6::from_iterator(of_place.iter().chain(&of_turn).copied()));
    }
    let stated = Vector6::new(1e-5, 2e-5, 3e-5, 1e-4, 2e-4, 3e-4);
    let expected = jacobian * Matrix6::from_diagonal(&stated.component_mul(&stated)) * jacobian.transpose();
    let found = pose.covariance.expect("stated");
    let scale = expected.diagonal().map(f64::sqrt);
    let apart = (found - expected).component_div(&(scale * scale.transpose())).amax();
    assert!(apart < 1e-6, "{apart}\n{found}{expected}");
}

#[test]
fn a_whole_covariance_is_read_from_either_half_or_both() {
    let factor = Matrix6::from_fn(|i, j| if i >= j { 1e-3 * (1.0 + i as f64 - 0.3 * j as f64) } else { 0.0 });
    let covariance = factor * factor.transpose();
    let mut places: Vec<(usize, usize)> = (0..6).flat_map(|i| (i..6).map(move |j| (i, j))).collect();
    let read = |places: &[(usize, usize)], matrix: &Matrix6<f64>| {
        let names: Vec<_> = places.iter().map(|(i, j)| format!("k{i}{j}")).collect();
        let map = map(&format!(
            "{}[covariance]\nunit = \"mm\"\nangle_unit = \"mrad\"\ncolumns = {names:?}\n",
            rotation_map("form = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]")
        ));
        let cells: Vec<_> = places.iter().map(|place| format!("{:?}", matrix[*place])).collect();
        mapped(&format!("s,t,x,y,z,a,b,c,{}\n1,2,3,4,5,0,0,0.1,{}\n", names.join(","), cells.join(",")), &map)
    };
    let upper = read(&places, &covariance).expect("21 columns");
    // mm² and mm mrad and mrad²: all a millionth of SI.
    let found = pose_of(&upper, 0).covariance.expect("stated");
    assert!((found * 1e6 - covariance).amax() < 1e-12 * covariance.amax());
    places = (0..6).flat_map(|i| (0..6).map(move |j| (i, j))).collect();
    assert_eq!(read(&places, &covariance).expect("36 columns").set, upper.set);
    let mut skew = covariance;
    skew[(4, 1)] *= 1.5;
    let refused = drawn(read(&places, &skew).expect_err("not symmetric"));
    assert!(refused.contains("set.csv:2: the covariance is not symmetric: k41 is"), "{refused}");
    let mut indefinite = covariance;
    (indefinite[(0, 3)], indefinite[(3, 0)]) = (1.0, 1.0);
    let refused = drawn(read(&places, &indefinite).expect_err("indefinite"));
    assert!(refused.contains("set.csv:2: the covariance of k00, k01,"), "{refused}");
    assert!(refused.contains("is not positive definite"), "{refused}");
}

#[test]
fn noise_by_distance_is_of_both_parts_of_a_pose() {
    let rotation = "form = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]";
    let noise = "[noise]\nrange_um = 10\ntransverse_um = 20\ntransverse_um_per_m = 5\nrotation_urad = 50\n";
    let map = map(&format!("{}{noise}", rotation_map(rotation)));
    let loaded = mapped("s,t,x,y,z,a,b,c\n1,2,3000,0,0,0.1,0.2,0.3\n", &map).expect("valid");
    let found = pose_of(&loaded, 0).covariance.expect("from the noise").diagonal().map(f64::sqrt);
    let expected = Vector6::new(1e-5, 3.5e-5, 3.5e-5, 5e-5, 5e-5, 5e-5);
    assert!((found - expected).amax() < 1e-15, "{found}");
}

#[test]
fn rows_that_are_no_pose_are_refused_where_they_are() {
    let quaternion =
        map(&rotation_map("form = \"quaternion\"\norder = \"wxyz\"\ncolumns = [\"a\", \"b\", \"c\", \"d\"]"));
    let matrix = map(&rotation_map(
        "form = \"matrix\"\norder = \"rows\"\ncolumns = [\"r1\", \"r2\", \"r3\", \"r4\", \"r5\", \"r6\", \"r7\", \"r8\", \"r9\"]",
    ));
    let with_sigma = map(&format!(
        "{}[sigma]\nunit = \"mm\"\nx = \"sx\"\ny = \"sx\"\nz = \"sx\"\n",
        rotation_map(
            "form = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]\nsigma = \"sr\"\nsigma_unit = \"rad\""
        )
    ));
    let q = "s,t,x,y,z,a,b,c,d\n1,2,3,4,5,1,0,0,0\n";
    let m = "s,t,x,y,z,r1,r2,r3,r4,r5,r6,r7,r8,r9\n";
    let s = "s,t,x,y,z,a,b,c,sx,sr\n";
    for (map, file, message, help) in [
        (
            &quaternion,
            format!("{q}1,2,3,4,5,0,0,0,0\n"),
            "set.csv:3: the quaternion has length 0 (columns a, b, c, d)",
            "leave its position empty: it then counts as a missed shot",
        ),
        (
            &quaternion,
            format!("{q}1,2,3,4,5,0.9,0.1,0,0\n"),
            "set.csv:3: the quaternion has length 0.905539, which differs from 1 by 9.4e-2",
            "its four columns, w among them",
        ),
        (
            &quaternion,
            format!("{q}1,2,3,4,5,,,,\n"),
            "set.csv:3: the rotation is empty (a, b, c, d)",
            "full poses or points",
        ),
        (&quaternion, format!("{q}1,2,3,4,5,1,0,,0\n"), "set.csv:3: column c is empty", "a number"),
        (
            &matrix,
            format!("{m}1,2,3,4,5,1,0,0,0,1,0,0,0,-1\n"),
            "set.csv:2: the matrix is left-handed: its determinant is -1.0000",
            "set the program that wrote it to a right-handed frame",
        ),
        (
            &matrix,
            format!("{m}1,2,3,4,5,1,0.1,0,0,1,0,0,0,1\n"),
            "set.csv:2: the matrix is not a rotation: its columns differ from unit vectors at right angles by 1.0e-1",
            "the nine columns of one matrix",
        ),
        (
            &with_sigma,
            format!("{s}1,2,3,4,5,0,0,0,0.1,\n"),
            "set.csv:2: the uncertainty of the position is stated, but that of the rotation is empty",
            "both in a row, or neither",
        ),
        (
            &with_sigma,
            format!("{s}1,2,3,4,5,0,0,0,,1e-4\n"),
            "set.csv:2: the uncertainty of the rotation is stated, but that of the position is empty",
            "rotation_urad",
        ),
        (&with_sigma, format!("{s}1,2,3,4,5,0,0,0,0.1,0\n"), "set.csv:2: column sr is \"0\"", "above zero"),
    ] {
        let refused = drawn(mapped(&file, map).expect_err(message));
        assert!(refused.contains(message), "{refused}\nlacks {message}");
        assert!(refused.contains(help), "{refused}\nlacks {help}");
    }
    // A shot that missed is one with and without a rotation.
    let missed = mapped(&format!("{q}1,2,,,,,,,\n1,2,0,0,0,1,0,0,0\n"), &quaternion).expect("dropped");
    assert_eq!((missed.set.observations.len(), missed.dropped.len()), (1, 2));
}

#[test]
fn few_digits_are_told() {
    let map =
        map(&rotation_map("form = \"quaternion\"\norder = \"wxyz\"\ncolumns = [\"a\", \"b\", \"c\", \"d\"]"));
    let loaded = mapped("s,t,x,y,z,a,b,c,d\n1,2,3,4,5,0.707,0.707,0,0\n", &map).expect("rounded");
    assert!((pose_of(&loaded, 0).rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    assert!(
        loaded.remarks[0].contains("rotations differ from exact ones by up to 1.5e-4"),
        "{:?}",
        loaded.remarks
    );
}

#[test]
fn points_and_poses_are_not_put_together() {
    let pose =
        "pose,q1_m,q2_rad,x_m,y_m,z_m,r11,r12,r13,r21,r22,r23,r31,r32,r33\n1,0,0,1,2,3,1,0,0,0,1,0,0,0,1\n";
    let point = "pose,q1_m,q2_rad,x_m,y_m,z_m\n2,0.5,0,1,2,4\n";
    let folder = tempfile::tempdir().expect("a folder");
    let paths = [("pose.csv", pose), ("point.csv", point)].map(|(name, text)| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("written");
        path
    });
    for [first, second] in [[0, 1], [1, 0]] {
        let files = MeasurementFiles {
            points: [first, second].map(|i| PointsFile { target: None, path: paths[i].clone() }).into(),
            joints: None,
        };
        let options = RowOptions::default();
        let refused =
            read_files(&files, &ColumnMap::default(), &KINDS, &options).expect_err("mixed").to_string();
        let (this, other) = if first == 0 { ("a point", "a full pose") } else { ("a full pose", "a point") };
        assert!(refused.contains(&format!(":2: this row is {this}, but ")), "{refused}");
        assert!(refused.contains(&format!("is {other}")), "{refused}");
    }
    let without_z = pose.replace("r33", "r34");
    let refused = own(&without_z).expect_err("misspelt").to_string();
    assert!(refused.contains("set.csv:1: column r33 is missing"), "{refused}");
    let spherical = "q1_m,q2_rad,range_m,az_rad,el_rad,r11\n0,0,1,2,3,1\n";
    let refused = own(spherical).expect_err("no place").to_string();
    assert!(refused.contains("a rotation, r11 to r33, but no x_m, y_m, z_m"), "{refused}");
}

#[test]
fn a_map_states_every_convention() {
    let vector = "form = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]";
    for (text, expected) in [
        (
            format!("{CARTESIAN}[rotation]\n{vector}\n"),
            "[rotation] does not say which frame is given in which",
        ),
        (rotation_map("columns = [\"a\"]"), "[rotation] does not say in which form its numbers are"),
        (rotation_map("form = \"quat\"\ncolumns = [\"a\"]"), "form is \"quat\""),
        (
            rotation_map("form = \"quaternion\"\ncolumns = [\"a\", \"b\", \"c\", \"d\"]"),
            "does not say the order of its quaternion",
        ),
        (
            rotation_map("form = \"euler\"\ncolumns = [\"a\", \"b\", \"c\"]"),
            "does not say the sequence of its angles",
        ),
        (
            rotation_map("form = \"euler\"\nsequence = \"zyx\"\ncolumns = [\"a\", \"b\", \"c\"]"),
            "sequence is \"zyx\"",
        ),
        (rotation_map("form = \"matrix\"\ncolumns = [\"a\"]"), "does not say the order of its matrix"),
        (
            rotation_map("form = \"kuka_abc\"\norder = \"wxyz\"\ncolumns = [\"a\", \"b\", \"c\"]"),
            "order does not belong to the form",
        ),
        (
            rotation_map("form = \"kuka_abc\"\ncolumns = [\"a\", \"b\"]"),
            "columns names 2 columns of the rotation",
        ),
        (
            rotation_map("form = \"abb_quaternion\"\nunit = \"deg\"\ncolumns = [\"a\", \"b\", \"c\", \"d\"]"),
            "unit applies to angles",
        ),
        (
            format!("{}[sigma]\nunit = \"mm\"\nx = \"u\"\ny = \"v\"\nz = \"w\"\n", rotation_map(vector)),
            "the uncertainty of positions is stated, but not that of rotations",
        ),
        (
            rotation_map(&format!("{vector}\nsigma = \"u\"\nsigma_unit = \"rad\"")),
            "the uncertainty of rotations is stated, but not that of positions",
        ),
        (
            format!("{CARTESIAN}[covariance]\ncolumns = [\"a\"]\n"),
            "[covariance] applies to full poses, but there is no [rotation]",
        ),
        (
            format!(
                "{}[covariance]\ncolumns = [\"a\"]\nunit = \"m\"\nangle_unit = \"rad\"\n",
                rotation_map(vector)
            ),
            "[covariance] names 1 columns",
        ),
        (
            format!("{}[covariance]\ncolumns = [\"a\"]\nunit = \"m\"\n", rotation_map(vector)),
            "[covariance] does not say its units",
        ),
    ] {
        let refused = refused_map(&text);
        assert!(refused.contains(expected), "{refused}\nlacks {expected}");
    }
    // The unit of angles may be in the header instead; where it is nowhere, the map lacks it.
    let map = map(&rotation_map("form = \"kuka_abc\"\ncolumns = [\"A\", \"B\", \"C\"]"));
    let loaded = mapped("s,t,x,y,z,A [deg],B [deg],C [deg]\n1,2,3,4,5,90,0,0\n", &map).expect("with units");
    assert!((pose_of(&loaded, 0).rotation * Vector3::x() - Vector3::y()).amax() < 1e-15);
    let refused = mapped("s,t,x,y,z,A,B,C\n1,2,3,4,5,90,0,0\n", &map).expect_err("no unit").to_string();
    assert!(refused.contains("missing key `unit` in [rotation]: column A has no unit"), "{refused}");
}

#[test]
fn repeats_of_a_pose_are_averaged_with_their_rotation() {
    let text = "s,t,x,y,z,a,b,c\n1,2,100,0,0,0.001,0,0.1\n1,2,102,0,0,-0.001,0,0.1\n5,2,100,0,0,0,0,3.1415\n5,2,100,0,0,0,0,-3.1415\n";
    let rotation =
        rotation_map("form = \"rotation_vector\"\nunit = \"rad\"\ncolumns = [\"a\", \"b\", \"c\"]");
    let map = map(&format!("{rotation}[rows]\nrepeats = \"average\"\n"));
    let loaded = mapped(text, &map).expect("valid");
    assert_eq!(loaded.set.observations.len(), 2);
    let mean = pose_of(&loaded, 0);
    assert!((mean.position.x - 0.101).abs() < 1e-15);
    assert!((rotation_vector(&mean.rotation) - Vector3::new(0.0, 0.0, 0.1)).amax() < 1e-8);
    // Half a turn either way round is the same place on the way.
    assert!(pose_of(&loaded, 1).rotation.angle() > std::f64::consts::PI - 1e-5);
}
