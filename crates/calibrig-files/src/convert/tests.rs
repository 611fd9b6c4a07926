use super::*;
use calibrig_model::ActuatorMap;
use proptest::prelude::*;

const TWO: &str = r#"<?xml version="1.0"?>
<robot name="two" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <link name="base"/>
  <link name="arm"><inertial><origin xyz="0.4 0 0"/><mass value="7"/><inertia ixx="0.1" ixy="0" ixz="0" iyy="0.3" iyz="0" izz="0.3"/></inertial></link>
  <link name="hand"><inertial><mass value="2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <link name="tool"/>
  <joint name="swing" type="revolute">
    <parent link="base"/><child link="arm"/>
    <origin xyz="0.1 0.2 0.5" rpy="0.3 0 0"/>
    <axis xyz="0 -1 0"/>
    <limit lower="-1" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <joint name="twist" type="continuous">
    <parent link="arm"/><child link="hand"/>
    <origin xyz="0.8 0 0"/>
    <axis xyz="1 0 0"/>
  </joint>
  <joint name="mount" type="fixed"><parent link="hand"/><child link="tool"/><origin xyz="0.1 0 0.05" rpy="0 0.2 0"/></joint>
  <transmission name="t"><type>simple</type></transmission>
  <gazebo reference="arm"/><gazebo reference="hand"/>
</robot>
"#;

fn convert(text: &str) -> Result<Converted, InputError> {
    robot_from_urdf(&Source::new("two.urdf", text), &UrdfOptions::default())
}

fn between(text: &str, base: &str, tip: &str) -> Result<Converted, InputError> {
    let options = UrdfOptions {
        base: Some(base.to_owned()),
        tip: Some(tip.to_owned()),
        target: Some(Vector3::new(0.01, -0.02, 0.03)),
        gravity: Some(Vector3::new(0.0, -9.81, 0.0)),
    };
    robot_from_urdf(&Source::new("two.urdf", text), &options)
}

/// Message, line and help of the refusal of `TWO` with `from` replaced by `to`.
fn refusal(from: &str, to: &str) -> (String, usize, String) {
    assert!(TWO.contains(from), "{from}");
    match convert(&TWO.replacen(from, to, 1)) {
        Err(InputError::Invalid { message, line, help, .. }) => (message, line, help.unwrap_or_default()),
        other => panic!("{from} -> {to}: {other:?}"),
    }
}

#[test]
fn what_the_urdf_says_is_taken_over_and_what_not_is_marked() {
    let made = convert(TWO).expect("a chain");
    let (text, robot) = (&made.source.text, &made.robot);
    let links = &robot.model.kinematics.links;
    assert_eq!(links.iter().map(|link| link.name.as_str()).collect::<Vec<_>>(), ["swing", "twist"]);
    assert!((links[0].limits[0] + 1.0).abs() < 1e-14 && (links[0].limits[1] - 1.5).abs() < 1e-14);
    assert!(made.difference.is_some_and(|difference| difference <= AGREEMENT));
    assert!(text.contains("ignored: 2 <gazebo>, 1 <transmission>"), "{text}");
    assert!(text.contains("min_deg = -360 # assumed"), "{text}");
    let statics = robot.model.statics.as_ref().expect("masses of both links");
    assert_eq!(statics.bodies.iter().map(|body| body.mass).collect::<Vec<_>>(), [7.0, 2.0]);
    assert_eq!(robot.compliance_sigma, Some(10.0));
    // The file that is written says the same as the robot that was read from it.
    let again = parse_robot(Source::new("robot.toml", text.clone()), None, None).expect("as written");
    assert_eq!(again.model, robot.model);
    assert!(made.remarks.iter().any(|line| line.contains("gravity along -z of base")), "{:?}", made.remarks);
}

/// What gravity does to the joints must not depend on the frames that the table has.
#[test]
fn masses_are_where_the_urdf_has_them() {
    let made = convert(TWO).expect("a chain");
    let statics = made.robot.model.statics.as_ref().expect("masses");
    let chain = &made.robot.model.kinematics;
    let arm = chain.base_from_first * chain.links[0].transform(0.3);
    let hand = arm * chain.links[1].transform(-0.4);
    let turn = nalgebra::Rotation3::from_euler_angles(0.3, 0.0, 0.0);
    let swung = turn * nalgebra::Rotation3::from_axis_angle(&-Vector3::y_axis(), 0.3);
    let at = Vector3::new(0.1, 0.2, 0.5);
    for (frame, body, expected) in [
        (arm, &statics.bodies[0], at + swung * Vector3::new(0.4, 0.0, 0.0)),
        (hand, &statics.bodies[1], at + swung * Vector3::new(0.8, 0.0, 0.0)),
    ] {
        let found = frame * nalgebra::Point3::from(body.centre_of_mass);
        assert!((found.coords - expected).norm() < 1e-12, "{found} {expected}");
    }
    let inertia = |frame: Transform, joint: usize| {
        let turn = frame.rotation.matrix();
        turn * statics.bodies[joint].inertia * turn.transpose()
    };
    let expected = swung.matrix()
        * nalgebra::Matrix3::from_diagonal(&Vector3::new(0.1, 0.3, 0.3))
        * swung.matrix().transpose();
    assert!((inertia(arm, 0) - expected).norm() < 1e-12);
}

#[test]
fn a_chain_may_go_up_the_tree_and_down_again() {
    let forth = between(TWO, "base", "tool").expect("a chain");
    let back = between(TWO, "tool", "base").expect("the same, from the other end");
    let [forth, back] = [forth, back].map(|made| made.robot);
    assert_eq!(back.model.kinematics.links[0].name, "twist");
    let there = flange(&forth, &[0.4, -0.7]);
    let and_back = flange(&back, &[-0.7, 0.4]);
    assert!(((there * and_back).to_homogeneous() - nalgebra::Matrix4::identity()).norm() < 1e-12);
    assert_eq!(forth.target(), Some(Vector3::new(0.01, -0.02, 0.03)));
    assert_eq!(forth.model.statics.expect("masses").gravity, Vector3::new(0.0, -9.81, 0.0));
}

#[test]
fn no_masses_cost_gravity_and_not_the_command() {
    for (from, to, said) in [
        ("<mass value=\"7\"/>", "<mass value=\"0\"/>", "no mass: link arm and the links fixed to it"),
        ("<mass value=\"2\"/>", "", "no mass: link hand and the links fixed to it"),
    ] {
        let made = convert(&TWO.replacen(from, to, 1)).expect("kinematics");
        assert!(made.robot.model.statics.is_none());
        assert!(made.remarks.iter().any(|line| line == said), "{:?}", made.remarks);
        assert!(made.remarks.iter().any(|line| line.contains("no gravity modes")));
    }
    let made = convert(&TWO.replacen("ixx=\"0.1\"", "ixx=\"-3\"", 1)).expect("at rest, inertia is nothing");
    assert!(made.robot.model.statics.is_some());
    assert!(
        made.remarks.iter().any(|line| line.contains("the inertia of link arm is not positive definite"))
    );
}

#[test]
fn limits_that_are_none_are_assumed() {
    for limit in
        ["lower=\"-inf\" upper=\"inf\"", "lower=\"-1e16\" upper=\"1e16\"", "lower=\"0\" upper=\"0\"", ""]
    {
        let text = TWO.replacen("lower=\"-1\" upper=\"1.5\"", limit, 1);
        let made = convert(&text).expect("a chain");
        assert!((made.robot.model.kinematics.links[0].limits[1] - std::f64::consts::TAU).abs() < 1e-12);
        assert!(
            made.remarks.iter().any(|line| line.contains("limits of joint swing, which states no limits"))
        );
    }
}

#[test]
fn a_joint_that_follows_is_coupled() {
    let text = TWO.replacen(
        "<joint name=\"mount\" type=\"fixed\"><parent link=\"hand\"/><child link=\"tool\"/>",
        "<link name=\"rod\"/><joint name=\"level\" type=\"revolute\"><parent link=\"hand\"/><child link=\"rod\"/><axis xyz=\"0 1 0\"/><limit lower=\"-2\" upper=\"2\"/><mimic joint=\"swing\" multiplier=\"-0.5\" offset=\"0.1\"/></joint><joint name=\"mount\" type=\"fixed\"><parent link=\"rod\"/><child link=\"tool\"/>",
        1,
    );
    let made = convert(&text).expect("a chain");
    let map = &made.robot.model.actuators;
    assert!(matches!(map, ActuatorMap::Axes { .. }));
    assert_eq!([0, 1, 2].map(|joint| map.is_commanded(joint)), [true, true, false]);
    let mut joints = [0.0; 3];
    map.joints_from_command(&[0.8, 0.3, 0.0], &mut joints);
    for (found, expected) in joints.iter().zip([0.8, 0.3, -0.3]) {
        assert!((found - expected).abs() < 1e-14, "{joints:?}");
    }
    assert!(made.source.text.contains("[joint.follows]\njoint = \"swing\"\nratio = -0.5\n"));
    let round = text.replacen("<limit lower=\"-1\"", "<mimic joint=\"level\"/><limit lower=\"-1\"", 1);
    // Told of the URDF, which is there to be looked at.
    let round = convert(&round).unwrap_err();
    assert!(round.to_string().contains("follow each other"), "{round}");
    assert!(round.to_string().starts_with("two.urdf:"), "{round}");
}

#[test]
fn base_and_tip_choose_and_what_can_be_meant_is_listed() {
    let branch = "<link name=\"probe\"/><joint name=\"p\" type=\"fixed\"><parent link=\"hand\"/><child link=\"probe\"/></joint>\n</robot>";
    let tree = TWO.replacen("</robot>", branch, 1);
    let refused = |made: Result<Converted, InputError>| match made {
        Err(InputError::Invalid { message, help, .. }) => format!("{message}: {}", help.unwrap_or_default()),
        other => panic!("{other:?}"),
    };
    let said = refused(convert(&tree));
    assert!(
        said.contains("2 links can be the tip") && said.contains("tool (2 moving joints), probe (2"),
        "{said}"
    );
    assert!(between(&tree, "base", "probe").is_ok());
    // The convention of ROS-Industrial decides, and is told.
    let made = convert(&tree.replace("\"tool\"", "\"tool0\"")).expect("tool0");
    assert!(made.remarks.iter().any(|line| line.contains("tip: tool0, not probe")), "{:?}", made.remarks);
    let said = refused(between(TWO, "base", "tol"));
    assert!(said.contains("--tip tol: no link has this name") && said.contains("arm, hand, tool"), "{said}");
    assert!(refused(between(TWO, "base", "swing")).contains("swing is the joint from link base to link arm"));
    assert!(refused(between(TWO, "hand", "tool")).contains("no joint between hand and tool moves"));
    let two_roots = TWO.replacen("</robot>", "<link name=\"b\"/><link name=\"c\"/><joint name=\"q\" type=\"prismatic\"><parent link=\"b\"/><child link=\"c\"/></joint></robot>", 1);
    assert!(refused(convert(&two_roots)).contains("2 links are not connected to any joint: base, b"));
    assert!(refused(between(&two_roots, "base", "c")).contains("belong to different trees"));
    assert!(between(&two_roots, "base", "tool").is_ok());
}

#[test]
fn mistakes_are_named_with_their_line_and_what_was_expected() {
    for (from, to, message, line, help) in [
        (
            "type=\"continuous\"",
            "type=\"floating\"",
            "joint twist is floating",
            13,
            "revolute, continuous, prismatic or fixed",
        ),
        (
            "type=\"continuous\"",
            "type=\"planar\"",
            "joint twist is planar",
            13,
            "--base and --tip so that this joint is not between them",
        ),
        (
            "<axis xyz=\"0 -1 0\"/>",
            "<axis xyz=\"0 0 0\"/>",
            "the axis of joint swing has length zero",
            10,
            "direction",
        ),
        (
            "<axis xyz=\"0 -1 0\"/>",
            "<axis xyz=\"0 -1\"/>",
            "xyz of <axis> is \"0 -1\"",
            10,
            "3 finite numbers",
        ),
        ("rpy=\"0.3 0 0\"", "rpy=\"0.3 nan 0\"", "rpy of <origin>", 9, "3 finite numbers"),
        ("<mass value=\"7\"/>", "<mass value=\"-7\"/>", "the mass of link arm is -7 kg", 4, "zero or more"),
        ("<child link=\"arm\"/>", "<child link=\"leg\"/>", "names a link leg that does not exist", 8, "link"),
        (
            "<link name=\"hand\">",
            "<link name=\"arm\">",
            "a second link named arm",
            5,
            "a different name for each link",
        ),
        (
            "<child link=\"tool\"/>",
            "<child link=\"arm\"/>",
            "which is already the child of joint swing",
            18,
            "one parent joint per link: a URDF cannot hold loops",
        ),
        ("<child link=\"arm\"/>", "<child link=\"arm\"/", "not valid XML:", 8, "URDF"),
        (
            "<axis xyz=\"1 0 0\"/>",
            "<axis xyz=\"1 0 0\"/><axis xyz=\"0 0 1\"/>",
            "joint twist has more than one <axis>",
            16,
            "only one",
        ),
        (
            "<mass value=\"2\"/>",
            "<mass value=\"2\"/><mass value=\"3\"/>",
            "of link hand has more than one <mass>",
            5,
            "only one",
        ),
        (
            "joint name=\"twist\"",
            "joint name=\"swing\"",
            "a second joint named swing",
            13,
            "a different name for each joint",
        ),
        (
            "<limit lower=\"-1\" upper=\"1.5\"",
            "<limit lower=\"1.5\" upper=\"-1\"",
            "the lower limit of joint swing is above its upper limit",
            11,
            "lower below upper",
        ),
        (
            "<gazebo reference=\"arm\"/>",
            "<xacro:macro name=\"a\"/>",
            "this is xacro source",
            20,
            "xacro two.urdf > two.expanded.urdf",
        ),
        ("xyz=\"0.8 0 0\"", "xyz=\"${reach} 0 0\"", "this is xacro source", 15, "ros2 run xacro xacro ..."),
    ] {
        let (found, at, expected) = refusal(from, to);
        assert!(found.contains(message), "{to}: {found}");
        assert!(expected.contains(help), "{to}: {expected}");
        assert_eq!(at, line, "{to}: {found}");
    }
}

#[test]
fn extensions_are_passed_over_and_what_is_no_urdf_refused() {
    let undeclared = TWO.replacen(" xmlns:xacro=\"http://www.ros.org/wiki/xacro\"", "", 1);
    assert!(convert(&undeclared).is_ok());
    assert!(
        convert(&undeclared.replacen("<gazebo reference=\"arm\"/>", "<xacro:include filename=\"a\"/>", 1))
            .unwrap_err()
            .to_string()
            .contains("xacro source")
    );
    // Extensions with prefixes that nobody declares, and what editors leave in front; places stay those of the file.
    let extended = format!(
        "\u{feff}\n{}",
        undeclared.replacen("<gazebo reference=\"arm\"/>", "<sensor:camera name=\"c\"/>", 1)
    );
    assert!(convert(&extended).is_ok());
    let InputError::Invalid { line, .. } = convert(&extended.replacen("0 -1 0", "0 0 0", 1)).unwrap_err()
    else {
        panic!("a place")
    };
    assert_eq!(line, 11);
    for nothing in
        ["", " \n", "garbage", "<", "<robot", "\u{feff}", "{}", "<a/>", "<robot/>", "<robot name=\"a\"/>"]
    {
        assert!(convert(nothing).is_err(), "{nothing}");
    }
    let deep = format!("<robot name=\"a\">{}", "<link name=\"a\">".repeat(100_000));
    assert!(convert(&deep).is_err());
}

fn table(text: &str, convention: Convention) -> Result<Converted, InputError> {
    robot_from_dh(&Source::new("table.csv", text), convention, None)
}

#[test]
fn a_table_of_a_manual_becomes_a_robot() {
    let text = "Joint;a [mm];α [deg];d [mm];θ [deg];min_deg;max_deg\nJ1;0;90;89,159;q1;-360;360\nJ2;-425;0;0;q2 - 90;-180;180\nJ3;0;0;0;-θ3;-10;90\n";
    let made = table(text, Convention::Standard).expect("a table");
    let links = &made.robot.model.kinematics.links;
    assert!(
        (links[0].d - 0.089_159).abs() < 1e-15
            && (links[1].theta + std::f64::consts::FRAC_PI_2).abs() < 1e-15
    );
    // Craig's rows count the a and alpha of the row before.
    assert!((links[2].a + 0.425).abs() < 1e-15);
    let mut joints = [0.0; 3];
    made.robot.model.actuators.joints_from_command(&[0.1, 0.2, 0.3], &mut joints);
    assert_eq!(joints, [0.1, 0.2, -0.3]);
    assert!((links[2].limits[0] + 90_f64.to_radians()).abs() < 1e-15, "{:?}", links[2].limits);

    let text = "a_m,alpha_rad,d_m,theta_rad,type\n0,0,0.3,0,R\n0.2,-pi/2,q2,pi,P\n0,3*pi/4,0.1,0,R\n";
    let made = table(text, Convention::Craig).expect("a table");
    let links = &made.robot.model.kinematics.links;
    assert_eq!(links[1].kind, JointKind::Prismatic);
    assert!((links[1].alpha + std::f64::consts::FRAC_PI_2).abs() < 1e-15);
    assert!((links[2].alpha - 0.75 * std::f64::consts::PI).abs() < 1e-15);
    assert!(made.remarks.iter().any(|line| line.contains("limits of J1, J2, J3")), "{:?}", made.remarks);
    assert!(made.source.text.contains("max_mm = 1000 # assumed"));
}

/// Joints may be counted from 0 or from 1 on, and some by their letter alone.
#[test]
fn variables_have_the_number_of_their_row() {
    for (first, second) in [("q1", "q2"), ("q0", "θ_1"), ("q", "theta2*"), ("q1", "q - 90")] {
        let text = format!("a_mm,alpha_deg,d_mm,theta_deg\n0,90,400,{first}\n900,0,0,{second}\n");
        assert!(table(&text, Convention::Craig).is_ok(), "{text}");
    }
}

/// Units that nobody can mean are told; nothing is changed.
#[test]
fn odd_units_are_doubted() {
    let doubted = |made: Converted| made.remarks.iter().any(|line| line.starts_with("doubtful: "));
    let dh = |alpha: &str, a: &str| {
        let text = format!(
            "a_mm,alpha_{alpha},d_mm,theta_deg\n0,{},400,q1\n{a},0,0,q2\n",
            if alpha == "deg" { "1.5708" } else { "90" }
        );
        table(&text, Convention::Craig).expect("a table")
    };
    assert!(doubted(dh("deg", "900")) && doubted(dh("rad", "900")));
    let good = |a: f64| {
        table(&format!("a_mm,alpha_deg,d_mm,theta_deg\n0,90,{a},q1\n{a},0,0,q2\n"), Convention::Craig)
            .expect("a table")
    };
    assert!(!doubted(good(400.0)) && doubted(good(4e5)) && doubted(good(0.4)));
    assert!(!doubted(convert(TWO).expect("a chain")));
    for (from, to) in [
        ("xyz=\"0.8 0 0\"", "xyz=\"800 0 0\""),
        ("rpy=\"0.3 0 0\"", "rpy=\"17.2 0 0\""),
        ("lower=\"-1\" upper=\"1.5\"", "lower=\"-57\" upper=\"86\""),
    ] {
        assert!(doubted(convert(&TWO.replacen(from, to, 1)).expect("a chain")), "{to}");
    }
}

#[test]
fn a_delimiter_in_quotes_is_no_delimiter() {
    let text = "a_mm,alpha_deg,d_mm,theta_deg,name\n0,90,400,q1,\"A1, waist\"\n";
    let made = table(text, Convention::Craig).expect("a table");
    assert_eq!(made.robot.model.kinematics.links[0].name, "A1, waist");
}

#[test]
fn columns_of_a_table_that_are_passed_over_are_told() {
    let text = "No;a_mm;alpha_deg;d_mm;theta_deg;Mass (kg);Remark\n1;0;90;400;0;7,5;x\n";
    let made = table(text, Convention::Craig).expect("a table");
    let told = made.remarks.iter().find(|line| line.starts_with("ignored:"));
    assert_eq!(told.map(String::as_str), Some("ignored: the columns Mass (kg), Remark"));
}

#[test]
fn tables_that_cannot_be_are_refused_with_their_cell() {
    const HEAD: &str = "name,a_mm,alpha_deg,d_mm,theta_deg\n";
    for (text, message, line) in [
        (String::new(), "the table is empty", 1),
        (HEAD.to_owned(), "the table has no rows", 1),
        ("name,a,alpha_deg,d_mm,theta_deg\nJ,0,0,0,0\n".to_owned(), "the column a has no unit", 1),
        ("name,a_deg,alpha_deg,d_mm,theta_deg\nJ,0,0,0,0\n".to_owned(), "or a unit of the other kind", 1),
        ("name,a_mm,d_mm,theta_deg\nJ,0,0,0\n".to_owned(), "there is no column alpha", 1),
        (format!("{HEAD}J1,0,0,0\n"), "4 cells, but the header has 5", 2),
        (format!("{HEAD}J1,0,0,0,x\n"), "\"x\" is not a number", 2),
        (format!("{HEAD}J1,0,0,0,0\nJ2,,0,0,0\n"), "an empty cell", 3),
        (format!("{HEAD}J1,0,0,q1,q1\n"), "both d and theta of J1 have a variable", 2),
        (format!("{HEAD}J1,q1,0,0,0\n"), "a of J1 has a joint variable", 2),
        (format!("{HEAD}J1,0,0,0,0\nJ1,0,0,0,0\n"), "a second joint \"J1\"", 3),
        (format!("{HEAD}J1,0,0,0,1e400\n"), "is not a number", 2),
        // The variable of another row's joint.
        (
            format!("{HEAD}J1,0,90,400,q2\nJ2,900,0,0,q1\n"),
            "\"q2\" is the variable of another joint, not of J1",
            2,
        ),
        (
            format!("{HEAD}J1,0,90,400,q1\nJ2,900,0,0,q1 - 90\n"),
            "\"q1 - 90\" is the variable of another joint",
            3,
        ),
        (format!("{HEAD}J1,0,90,400,q1\nJ2,900,0,0,q3\n"), "\"q3\" is the variable of another joint", 3),
        (format!("{HEAD}J1,0,90,400,q1\nJ2,900,0,0,q2 + q3\n"), "more than one joint variable", 3),
    ] {
        match table(&text, Convention::Standard) {
            Err(InputError::Invalid { message: found, line: at, .. }) => {
                assert!(found.contains(message), "{text}: {found}");
                assert_eq!(at, line, "{text}");
            }
            other => panic!("{text}: {other:?}"),
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn no_mutation_of_a_urdf_panics(
        at in 0usize..1900, remove in 0usize..12, insert in "\\PC{0,4}|[<>/\"'=!?&; \n-]{0,4}", cut in prop::option::of(0usize..1900)
    ) {
        let mut text: Vec<char> = TWO.chars().collect();
        let at = at.min(text.len());
        let end = (at + remove).min(text.len());
        text.splice(at..end, insert.chars());
        text.truncate(cut.unwrap_or(usize::MAX));
        let text: String = text.into_iter().collect();
        if let Err(error) = convert(&text) {
            let drawn = format!("{:?}", miette::Report::new(error));
            prop_assert!(!drawn.is_empty());
        }
    }

    #[test]
    fn no_text_panics_as_a_table(text in "([a_mdthet,;\t\n q0-9.+*/-]|\\PC|theta_deg|alpha_rad|pi){0,60}") {
        let head = "a_mm,alpha_rad,d_mm,theta_deg\n";
        for text in [text.clone(), format!("{head}{text}")] {
            if let Err(error) = table(&text, Convention::Craig) {
                let drawn = format!("{:?}", miette::Report::new(error));
                prop_assert!(!drawn.is_empty());
            }
        }
    }
}
