//! Input files with one thing wrong, given to the process: each refusal names the file, the line, the key or column and what was expected.

use std::sync::OnceLock;

use calibrig::files::InputError;
use calibrig::files::load_robot;
use calibrig::files::write_measurements;
use calibrig::model::JointKind;
use calibrig::pipeline::{PlantKind, simulate};
use calibrig::scenario::load_scenario;

use crate::sandbox::{ROBOT, SCENARIO, Sandbox, URDF, assert_refused};

/// Where the error is, seen from the line that was changed.
#[derive(Clone, Copy)]
enum Line {
    Same,
    /// The header of the table.
    Header,
    First,
    /// So many lines below.
    Below(usize),
}
use Line::{Below, First, Header, Same};

/// A change of a line: marker, begin of the line, new line; then the line of the error, its message, and what was expected.
type Mistake<'a> = (&'a str, &'a str, &'a str, Line, &'a str, &'a str);

fn expected_line(sandbox: &Sandbox, file: &str, changed: usize, line: Line) -> usize {
    match line {
        Same => changed,
        First => 1,
        Below(lines) => changed + lines,
        Header => {
            let text = sandbox.read(file);
            let above: Vec<_> = text.lines().take(changed).collect();
            above.iter().rposition(|line| line.starts_with('[')).expect("a header above") + 1
        }
    }
}

#[track_caller]
fn in_scenario(mistakes: &[Mistake]) {
    for (marker, start, with, line, message, expected) in mistakes {
        let sandbox = Sandbox::new();
        let changed = sandbox.replace_line(SCENARIO, marker, start, with);
        let place = format!("{SCENARIO}:{}: ", expected_line(&sandbox, SCENARIO, changed, *line));
        for arguments in
            [&["check", SCENARIO][..], &["run", SCENARIO, "--out", "out"], &["identifiability", SCENARIO]]
        {
            assert_refused(&sandbox, arguments, &place, message, expected);
        }
    }
}

#[track_caller]
fn in_robot(file: &str, mistakes: &[Mistake]) {
    for (marker, start, with, line, message, expected) in mistakes {
        let sandbox = Sandbox::new();
        let changed = sandbox.replace_line(file, marker, start, with);
        let line = expected_line(&sandbox, file, changed, *line);
        let arguments = ["identifiability", "--model", ROBOT];
        assert_refused(&sandbox, &arguments, &format!("{file}:{line}: "), message, expected);
        // A scenario names the robot by a path relative to itself.
        let place = format!("scenarios/../{file}:{line}: ");
        for arguments in [&["check", SCENARIO][..], &["run", SCENARIO, "--out", "out"]] {
            assert_refused(&sandbox, arguments, &place, message, expected);
        }
    }
}

const WAIST: &str = "name = \"waist\"";
const TRACKER: &str = "[tracker]";
const IDENTIFICATION: &str = "[identification]";

#[test]
fn a_user_forgets_the_unit() {
    in_robot(
        ROBOT,
        &[
            (WAIST, "d_mm", "d = 626", Same, "unknown key `d`", "`d_mm`: the unit is part of the key"),
            (WAIST, "max_deg", "max = 60", Same, "unknown key `max`", "`max_mm` or `max_deg`: the unit"),
            (
                WAIST,
                "stiffness",
                "stiffness = 1e6",
                Same,
                "unknown key `stiffness`",
                "`stiffness_nm_per_rad`",
            ),
            ("[target]", "x_mm", "x = 100", Same, "unknown key `x`", "`x_mm`: the unit"),
        ],
    );
    in_scenario(&[
        (
            TRACKER,
            "yaw_deg",
            "yaw = 180",
            Same,
            "unknown key `yaw`",
            "`yaw_deg`: the unit is part of the key",
        ),
        (
            "joint = \"rail\"",
            "delta_d_mm",
            "delta_d = 1",
            Same,
            "unknown key `delta_d`",
            "`delta_d_mm`: the unit",
        ),
        (
            "[poses]",
            "half_width_mm",
            "half_width = 1",
            Same,
            "unknown key `half_width`",
            "`half_width_mm` or",
        ),
    ]);
}

#[test]
fn a_user_gives_another_unit() {
    in_robot(
        ROBOT,
        &[
            (
                WAIST,
                "min_deg",
                "min_mm = -60",
                Same,
                "min_mm of joint \"waist\", which is revolute",
                "min_deg",
            ),
            (
                WAIST,
                "stiffness",
                "stiffness_n_per_m = 1e6",
                Same,
                "stiffness_n_per_m of joint",
                "stiffness_nm_per_rad",
            ),
        ],
    );
    in_scenario(&[(
        "[poses]",
        "half_width_mm",
        "half_width_rad = 1",
        Header,
        "joint \"rail\" needs centre_mm and half_width_mm",
        "the unit is part of the key",
    )]);
}

#[test]
fn a_user_misspells_a_key() {
    in_robot(
        ROBOT,
        &[
            (
                WAIST,
                "type",
                "kind = \"revolute\"",
                Same,
                "unknown key `kind`",
                "one of `name`, `type`, `a_mm`",
            ),
            ("", "[gravity]", "[gravitation]", Same, "unknown key `gravitation`", "`gravity`"),
        ],
    );
    in_scenario(&[
        ("", "seed", "sead = 1", Same, "unknown key `sead`", "`seed`"),
        (TRACKER, "noise", "noisy = true", Same, "unknown key `noisy`", "`noise`"),
        ("", "[[tracker.nest]]", "[[tracker.nests]]", Same, "unknown key `nests`", "`nest`"),
    ]);
}

#[test]
fn a_user_leaves_a_key_out() {
    in_robot(
        ROBOT,
        &[
            (
                WAIST,
                "d_mm",
                "",
                Header,
                "missing key `d_mm` in [joint]",
                "`d_mm` with a value; the unit is part",
            ),
            (WAIST, "max_deg", "", Header, "joint \"waist\" has no max_deg", "max_deg"),
            (WAIST, "stiffness", "", Header, "joint \"waist\" has no stiffness_nm_per_rad", "of every drive"),
            ("", "schema", "", First, "missing key `schema`", "`schema` with a value"),
            ("[actuators]", "kind", "", Header, "missing key `kind` in [actuators]", "`kind`"),
            ("[gravity]", "y_m_per_s2", "", Header, "missing key `y_m_per_s2` in [gravity]", "`y_m_per_s2`"),
        ],
    );
    in_scenario(&[
        ("", "seed", "", First, "missing key `seed`", "`seed`"),
        (
            TRACKER,
            "preset",
            "",
            Header,
            "missing key `transverse_um` in [tracker]",
            "`transverse_um` with a value; the unit",
        ),
        ("[[tracker.nest]]", "x_mm", "", Header, "missing key `x_mm` in [tracker.nest]", "`x_mm`"),
        ("[poses]", "verification", "", Header, "poses.verification is missing", "verification_from"),
        ("[poses]", "half_width_mm", "", Header, "joint \"rail\" needs centre_mm and half_width_mm", "unit"),
    ]);
}

#[test]
fn a_user_gives_the_wrong_type() {
    let whole = "a whole number from 0 to";
    in_robot(
        ROBOT,
        &[
            (WAIST, "d_mm", "d_mm = \"626\"", Same, "joint.d_mm is \"626\"", "a number"),
            (
                WAIST,
                "type",
                "type = \"helical\"",
                Same,
                "joint.type is \"helical\"",
                "`revolute` or `prismatic`",
            ),
            (WAIST, "type", "type = 3", Same, "joint.type is 3", "quotes"),
            ("", "name", "name = 3", Same, "name is 3", "a text in quotes"),
            (
                "",
                "convention",
                "convention = \"denavit\"",
                Same,
                "convention is \"denavit\"",
                "`craig` or `standard`",
            ),
        ],
    );
    in_scenario(&[
        ("", "seed", "seed = 1.5", Same, "seed is 1.5", whole),
        ("", "seed", "seed = \"1\"", Same, "seed is \"1\"", whole),
        (TRACKER, "noise", "noise = 1", Same, "tracker.noise is 1", "true or false"),
        (TRACKER, "x_mm", "x_mm = [1, 2]", Same, "tracker.x_mm is [1, 2]", "a number"),
        (
            IDENTIFICATION,
            "frame",
            "frame = \"nest\"",
            Same,
            "identification.frame is \"nest\"",
            "`nests`, `sweeps`, `free`, `fixed`",
        ),
        (
            IDENTIFICATION,
            "modes",
            "modes = [\"all\"]",
            Same,
            "identification.modes is \"all\"",
            "`only_calibration`",
        ),
        (
            "[[published]]",
            "max_mm",
            "max_mm = [1, 2]",
            Same,
            "published.max_mm is [1, 2]",
            "a list of 3 numbers",
        ),
        ("[[published]]", "max_mm", "max_mm = 1", Same, "published.max_mm is 1", "a list of 3 numbers"),
    ]);
}

#[test]
fn a_user_describes_a_structure_that_cannot_be() {
    in_robot(
        ROBOT,
        &[
            (
                "name = \"rail\"",
                "stiffness_x_n_per_m",
                "stiffness_x = 1e9",
                Same,
                "unknown key `stiffness_x`",
                "`stiffness_x_n_per_m`: the unit",
            ),
            (
                "name = \"rail\"",
                "stiffness_ry",
                "stiffness_z_n_per_m = 1e9",
                Same,
                "along or about the axis of joint \"rail\"",
                "stiffness_n_per_m of the joint itself",
            ),
            ("[joint.beam]", "wall_mm", "wall_mm = -10", Same, "wall_mm is -10", "above zero"),
            (
                "run = \"ends_at_origin\"",
                "housed_mm",
                "housed_mm = 1750",
                Same,
                "leaves no length of the segment",
                "min_mm",
            ),
            (
                "[actuators.linkage]",
                "rod_mm",
                "rod_mm = 1800",
                Header,
                "does not close with the elbow at -45.0 deg",
                "rod_mm",
            ),
            (
                "",
                "[target]",
                "[[load]]\nname = \"hose\"\njoint = \"hand\"\nx_mm = 0\ny_mm = 0\nz_mm = 0\nmass_kg = 1\n[target]",
                Below(2),
                "load \"hose\": no joint is named \"hand\"",
                "one of rail, waist",
            ),
        ],
    );
    in_scenario(&[
        (
            "",
            "[poses]",
            "[[as_built.load]]\nname = \"hose\"\njoint = \"wrist\"\nx_mm = 0\ny_mm = 0\nz_mm = 0\n[poses]",
            Same,
            "load \"hose\" has neither mass nor force",
            "mass_kg",
        ),
        (
            "",
            "[poses]",
            "[as_built.drawn]\ndistribution = \"normal\"\nmass_fraction = 0.5\n[poses]",
            Below(2),
            "mass_fraction is 0.5",
            "at most 0.2",
        ),
        (
            "joint = \"rail\"",
            "joint",
            "joint = \"rail\"\nbeam_factor = 1.1",
            Below(1),
            "beam_factor: joint \"rail\" has no [joint.beam]",
            "[joint.beam]",
        ),
    ]);
}

#[test]
fn a_user_gives_a_key_or_a_joint_twice() {
    in_robot(
        ROBOT,
        &[
            (
                WAIST,
                "d_mm",
                "d_mm = 626\nd_mm = 627",
                Below(1),
                "duplicate key `d_mm`",
                "every key only once",
            ),
            (
                "",
                "name = \"shoulder\"",
                WAIST,
                Same,
                "a second joint \"waist\"",
                "a different name for each joint",
            ),
        ],
    );
    in_scenario(&[
        ("", "seed", "seed = 1\nseed = 2", Below(1), "duplicate key `seed`", "every key only once"),
        (
            "",
            "joint = \"waist\"",
            "joint = \"rail\"",
            Same,
            "joint \"rail\" is given twice",
            "one entry per joint",
        ),
        (
            "[poses]",
            "joint = \"waist\"",
            "joint = \"rail\"",
            Same,
            "joint \"rail\" is given twice",
            "one entry per joint",
        ),
        (
            TRACKER,
            "name = \"rail right\"",
            "name = \"rail left\"",
            Same,
            "a second nest \"rail left\"",
            "a different name for each nest",
        ),
    ]);
}

#[test]
fn a_user_gives_a_number_that_is_none() {
    in_robot(
        ROBOT,
        &[
            (WAIST, "d_mm", "d_mm = nan", Same, "d_mm is nan", "a finite number"),
            (WAIST, "d_mm", "d_mm = -inf", Same, "d_mm is -inf", "a finite number"),
            (WAIST, "d_mm", "d_mm = 1e308", Same, "d_mm is 1e308", "at most 1e15"),
            (WAIST, "d_mm", "d_mm = 1e999", Same, "joint.d_mm is 1e999", "a finite number"),
            (WAIST, "d_mm", "d_mm = 626,5", Same, "joint.d_mm has a decimal comma", "a decimal point"),
            (WAIST, "d_mm", "d_mm =", Same, "joint.d_mm has no value", "a value after the `=`"),
            (WAIST, "d_mm", "d_mm = abc", Same, "joint.d_mm is abc", "a number"),
            ("[gravity]", "y_m_per_s2", "y_m_per_s2 = nan", Same, "y_m_per_s2 is nan", "a finite number"),
        ],
    );
    in_scenario(&[
        (TRACKER, "yaw_deg", "yaw_deg = nan", Same, "tracker.yaw_deg is nan", "a finite number"),
        ("joint = \"rail\"", "delta_d_mm", "delta_d_mm = inf", Same, "delta_d_mm is inf", "a finite number"),
        (
            "[[published]]",
            "max_mm",
            "max_mm = [1, nan, 2]",
            Same,
            "published.max_mm is nan",
            "a finite number",
        ),
        ("[poses]", "centre_rad", "centre_rad = nan", Same, "centre_rad is nan", "a finite number"),
    ]);
}

#[test]
fn a_user_gives_a_number_out_of_its_range() {
    let seeds = "a whole number from 0 to 18446744073709551615";
    in_scenario(&[
        ("", "seed", "seed = -1", Same, "seed is -1", seeds),
        ("", "seed", "seed = 18446744073709551616", Same, "seed is 18446744073709551616", seeds),
        (
            "[poses]",
            "identification",
            "identification = 0",
            Same,
            "poses.identification is 0",
            "1 to 100000 poses",
        ),
        (
            "[poses]",
            "identification",
            "identification = -1",
            Same,
            "poses.identification is -1",
            "a whole number",
        ),
        ("[poses]", "verification", "verification = 4294967295", Same, "is 4294967295", "0 to 100000 poses"),
        (TRACKER, "preset", "transverse_um = -15", Same, "tracker.transverse_um is -15", "above zero"),
        (
            TRACKER,
            "random_fraction",
            "range_um_per_m = -1",
            Same,
            "tracker.range_um_per_m is -1",
            "zero or more",
        ),
        (TRACKER, "nest_sigma_um", "nest_sigma_um = 0", Same, "tracker.nest_sigma_um is 0", "above zero"),
        (
            TRACKER,
            "nest_sigma_um",
            "nest_sigma_um = 1e-300",
            Same,
            "nest_sigma_um is 1e-300",
            "at least 1e-15",
        ),
        (
            TRACKER,
            "target_sigma_um",
            "target_sigma_um = -1",
            Same,
            "tracker.target_sigma_um is -1",
            "above zero",
        ),
        (
            "joint = \"waist\"",
            "stiffness_factor",
            "stiffness_factor = 0",
            Same,
            "stiffness_factor is 0",
            "above zero",
        ),
        ("joint = \"shoulder\"", "mass_factor", "mass_factor = -1", Same, "mass_factor is -1", "above zero"),
        (
            IDENTIFICATION,
            "unmodelled",
            "unmodelled_sigma_um = -1",
            Same,
            "unmodelled_sigma_um is -1",
            "zero or more",
        ),
        (IDENTIFICATION, "max_iterations", "max_iterations = 0", Same, "max_iterations is 0", "at least one"),
        (IDENTIFICATION, "modes", "modes = []", Same, "identification.modes is empty", "at least one mode"),
        ("", "name", "name = \" \"", Same, "name is empty", "a name"),
    ]);
    in_robot(
        ROBOT,
        &[
            (WAIST, "stiffness", "stiffness_nm_per_rad = 0", Same, "stiffness_nm_per_rad is 0", "above zero"),
            (
                WAIST,
                "stiffness",
                "stiffness_nm_per_rad = -1e6",
                Same,
                "stiffness_nm_per_rad is -1e6",
                "above zero",
            ),
            (
                WAIST,
                "max_deg",
                "max_deg = -90",
                Same,
                "max_deg of joint \"waist\" is not above min_deg",
                "below the upper",
            ),
            (
                WAIST,
                "max_deg",
                "max_deg = -60",
                Same,
                "max_deg of joint \"waist\" is not above min_deg",
                "below the upper",
            ),
        ],
    );
}

#[test]
fn a_user_asks_for_poses_that_the_robot_does_not_reach() {
    in_scenario(&[
        (
            "[poses]",
            "half_width_mm",
            "half_width_mm = 2001",
            Header,
            "centre_mm and half_width_mm let joint \"rail\" move from -1.0000 to 4001.0000 mm",
            "its limits, 0.0000 to 4000.0000 mm",
        ),
        ("[poses]", "half_width_mm", "half_width_mm = -1", Same, "half_width_mm is -1", "zero or more"),
        ("[poses]", "joint = \"rail\"", "joint = \"rial\"", Same, "no joint \"rial\"", "one of: rail, waist"),
    ]);
    let sandbox = Sandbox::new();
    let scenario = sandbox.read(SCENARIO);
    let region = scenario.rfind("[[poses.region]]").expect("a region");
    let end = region + scenario[region..].find("\n\n").expect("a next table");
    sandbox.write(SCENARIO, format!("{}{}", &scenario[..region], &scenario[end..]));
    let first = scenario.lines().position(|line| line == "[[poses.region]]").expect("a region") + 1;
    let message = "[[poses.region]] for joint \"wrist\" is missing";
    let place = format!("{SCENARIO}:{first}: ");
    assert_refused(&sandbox, &["run", SCENARIO], &place, message, "one entry per commanded joint");
}

#[test]
fn a_user_names_a_parameter_that_there_is_not() {
    let choices = "\"neighbour_axis_rules\", \"complete\", or a list";
    in_scenario(&[
        (
            IDENTIFICATION,
            "parameters",
            "parameters = \"rules\"",
            Same,
            "identification.parameters: \"rules\"",
            choices,
        ),
        (
            IDENTIFICATION,
            "parameters",
            "parameters = [\"delta_a8\"]",
            Same,
            "\"delta_a8\" is not a link",
            "from 1 to 7",
        ),
        (
            IDENTIFICATION,
            "parameters",
            "parameters = [\"delta_a0\"]",
            Same,
            "\"delta_a0\" is not a link",
            "from 1 to 7",
        ),
        (
            IDENTIFICATION,
            "parameters",
            "parameters = [\"frame_x\"]",
            Same,
            "\"frame_x\" is not a link",
            "delta_theta",
        ),
        (IDENTIFICATION, "parameters", "parameters = 24", Same, "identification.parameters: 24", choices),
    ]);
}

#[test]
fn a_user_places_the_nests_badly() {
    let sandbox = Sandbox::new();
    for (key, value) in [("x_mm", "600"), ("y_mm", "50"), ("z_mm", "-290")] {
        sandbox.set(TRACKER, key, value);
    }
    let near = sandbox.set("name = \"rail left\"", "x_mm", "600") - 2;
    let place = format!("{SCENARIO}:{near}: ");
    let message = "nest \"rail left\" is 0.010 m from the tracker";
    assert_refused(&sandbox, &["run", SCENARIO], &place, message, "0.1 to 30 m");

    let sandbox = Sandbox::new();
    sandbox.set(TRACKER, "x_mm", "65000");
    assert_refused(&sandbox, &["run", SCENARIO], &place, "from the tracker", "0.1 to 30 m");

    // All on the line through (0, 0, z), one of them 0.09 mm off: less than ten times the 10 um of their certificates.
    let on_a_line = |off: f64| {
        let sandbox = Sandbox::new();
        let scenario = sandbox.read(SCENARIO);
        let (head, tail) = scenario.split_once("[[tracker.nest]]").expect("nests");
        let rest = &tail[tail.find("\n# ---").expect("a next section")..];
        let nest = |i: i32, x: f64| {
            format!("[[tracker.nest]]\nname = \"{i}\"\nx_mm = {x}\ny_mm = 0\nz_mm = {}\n", 1000 * i)
        };
        let nests = format!("{}{}{}{}", nest(0, 0.0), nest(1, off), nest(2, 0.0), nest(3, 0.0));
        sandbox.write(SCENARIO, format!("{head}{nests}{rest}"));
        sandbox
    };
    let place = format!("{SCENARIO}:{near}: ");
    let message = "the base nests lie on one line, within 0.090 mm";
    assert_refused(&on_a_line(0.09), &["run", SCENARIO], &place, message, "0.100 mm off the line");
    assert_eq!(on_a_line(0.11).run(["check", SCENARIO]).code, Some(0));
}

#[test]
fn a_user_has_too_few_poses() {
    let sandbox = Sandbox::new();
    let line = sandbox.set("[poses]", "identification", "2");
    let place = format!("{SCENARIO}:{line}: ");
    assert_refused(
        &sandbox,
        &["run", SCENARIO, "--out", "out"],
        &place,
        "fewer than three",
        "at least three poses",
    );

    sandbox.set("[poses]", "identification", "8");
    sandbox.set(IDENTIFICATION, "frame", "\"free\"");
    sandbox.set(IDENTIFICATION, "target", "\"identified\"");
    // 24 coordinates for the published 24, six of the frame and three of the target.
    let message = "24 measured coordinates and priors for 33 parameters";
    assert_refused(&sandbox, &["run", SCENARIO, "--out", "out"], &place, message, "at least 3 more poses");
}

#[test]
fn a_user_names_a_file_that_is_absent_or_a_folder() {
    let sandbox = Sandbox::new();
    sandbox.write("empty.toml", "");
    sandbox.write("binary.toml", [0xff, 0xfe, 0x00]);
    for (file, place, message, expected) in [
        ("nowhere.toml", "cannot read nowhere.toml: ", "No such file", "a text file in UTF-8"),
        ("models", "cannot read models: ", "it is a folder", "a text file in UTF-8"),
        (
            "scenarios/paper.toml/x.toml",
            "cannot read scenarios/paper.toml/x.toml: ",
            "Not a directory",
            "a text file in UTF-8",
        ),
        ("binary.toml", "cannot read binary.toml: ", "not UTF-8 text (byte 0)", "UTF-8"),
        ("empty.toml", "empty.toml:1: ", "missing key `schema`", "`schema`"),
        (URDF, "models/spray_painter/robot.urdf:1: ", "key with no value", "`=`"),
    ] {
        for arguments in [
            &["check", file][..],
            &["run", file],
            &["identifiability", file],
            &["identifiability", "--model", file],
            &["identify", "--model", file, "--measurements", "none.csv"],
        ] {
            assert_refused(&sandbox, arguments, place, message, expected);
        }
    }
    let beside = "relative to this";
    in_scenario(&[
        ("", "robot", "robot = \"none.toml\"", Same, "robot: cannot read scenarios/none.toml", beside),
        ("", "robot", "robot = \"../models\"", Same, "it is a folder", beside),
    ]);
    in_robot(
        ROBOT,
        &[
            ("", "urdf", "urdf = \"none.urdf\"", Same, "urdf: cannot read", beside),
            ("", "urdf", "urdf = \".\"", Same, "it is a folder", beside),
        ],
    );
}

#[test]
fn a_user_confuses_the_files() {
    let sandbox = Sandbox::new();
    for (arguments, place, message) in [
        (["check", ROBOT].as_slice(), ROBOT, "unknown key"),
        (&["identifiability", "--model", SCENARIO], SCENARIO, "unknown key"),
    ] {
        assert_refused(&sandbox, arguments, place, message, "`schema`");
    }
    in_scenario(&[(
        "",
        "schema",
        "schema = \"calibrig.scenario/2\"",
        Same,
        "scenario/2",
        "\"calibrig.scenario/1\"",
    )]);
    in_robot(
        ROBOT,
        &[("", "schema", "schema = \"calibrig.robot/2\"", Same, "robot/2", "\"calibrig.robot/1\"")],
    );
}

#[test]
fn a_user_has_statics_by_halves() {
    in_robot(
        ROBOT,
        &[("", "urdf", "", First, "stiffnesses and [gravity], but no masses", "urdf = \"robot.urdf\"")],
    );
    let sandbox = Sandbox::new();
    let robot = sandbox.read(ROBOT);
    let (without, _) = robot.split_once("[gravity]").expect("gravity");
    sandbox.write(ROBOT, without);
    let rail = robot.lines().position(|line| line == "[[joint]]").expect("a joint") + 1;
    let place = format!("{ROBOT}:{rail}: ");
    let message = "the drives have stiffnesses, but there is no [gravity]";
    assert_refused(&sandbox, &["identifiability", "--model", ROBOT], &place, message, "[gravity]");

    // A scenario needs all of them.
    const UR5: &str = "models/ur5/robot.toml";
    let sandbox = Sandbox::new();
    let rigid = sandbox.read(UR5);
    let (rigid, _) = rigid.split_once("# The base stands upright.").expect("gravity");
    let kept = rigid.lines().filter(|line| !line.starts_with("stiffness"));
    let half: Vec<_> = kept.collect();
    sandbox.write(UR5, half.join("\n"));
    let line = half.iter().position(|line| line.starts_with("compliance_percent")).expect("the key") + 1;
    let message = "there is a compliance_percent, but no drive has a stiffness";
    let place = format!("{UR5}:{line}: ");
    assert_refused(&sandbox, &["identifiability", "--model", UR5], &place, message, "[gravity]");
    let rigid: Vec<_> = half.into_iter().filter(|line| !line.starts_with("compliance_percent")).collect();
    sandbox.write(UR5, rigid.join("\n"));
    let line = sandbox.replace_line(SCENARIO, "", "robot", "robot = \"../models/ur5/robot.toml\"");
    let place = format!("{SCENARIO}:{line}: ");
    let message = "the robot's files give no masses, drive stiffnesses and gravity";
    assert_refused(&sandbox, &["run", SCENARIO], &place, message, "a URDF with inertials");
}

#[test]
fn a_user_has_a_urdf_that_does_not_match() {
    let joint = "<joint name=\"waist\"";
    let with = |name: &str, kind: &str| format!("  <joint name=\"{name}\" type=\"{kind}\">");
    let (renamed, slides, helical) =
        (with("hip", "revolute"), with("waist", "prismatic"), with("waist", "helical"));
    let open = "  <joint name=\"waist\" type=\"revolute\">";
    in_robot(
        URDF,
        &[
            ("", joint, &renamed, Same, "joint 2 (hip): name \"hip\" differs from robot.toml", "\"waist\""),
            ("", joint, &slides, Same, "joint 2 (waist): type prismatic differs from robot.toml", "revolute"),
            ("", joint, &helical, Same, "type of <joint> is \"helical\"", "revolute, prismatic or fixed"),
            ("", joint, "  <joint name=\"waist\">", Same, "<joint> has no type", "type=\"...\""),
        ],
    );
    for (marker, start, line, above, message, expected) in [
        (
            open,
            "<origin",
            "<origin xyz=\"0 0.627 0\" rpy=\"0 0 0\"/>",
            open,
            "joint 2 (waist): origin",
            "xyz=\"0",
        ),
        (open, "<parent", "", open, "<joint> has no <parent>", "<parent .../>"),
        (
            open,
            "<parent",
            "<parent link=\"cariage\"/>",
            open,
            "names a link cariage that does not exist",
            "a link",
        ),
        (open, "<limit", "", open, "joint waist has no <limit>", "the limits of robot.toml"),
        (
            open,
            "<limit",
            "<limit lower=\"-2\" upper=\"2\" effort=\"1\" velocity=\"1\"/>",
            open,
            "joint 2 (waist): lower limit -2 differs",
            "-1.047",
        ),
        ("", "</robot>", "", "<robot name=\"spray_painter\">", "<robot> is not closed", "a URDF"),
    ] {
        let sandbox = Sandbox::new();
        sandbox.replace_line(URDF, marker, start, line);
        let at = sandbox.read(URDF).lines().position(|line| line == above).expect("the element") + 1;
        let place = format!("{URDF}:{at}: ");
        assert_refused(&sandbox, &["identifiability", "--model", ROBOT], &place, message, expected);
    }
    let mass = "  <link name=\"waist\">";
    let huge = "<mass value=\"1e400\"/>";
    in_robot(
        URDF,
        &[
            (
                mass,
                "<mass",
                "<mass value=\"-400\"/>",
                Same,
                "the mass of link waist is -400 kg",
                "a mass above zero",
            ),
            (mass, "<mass", "<mass value=\"nan\"/>", Same, "value of <mass> is \"nan\"", "a finite number"),
            (mass, "<mass", huge, Same, "value of <mass> is \"1e400\"", "a finite number"),
            (mass, "<mass", "<mass weight=\"400\"/>", Same, "unknown attribute weight of <mass>", "value"),
            (mass, "<mass", "<mas value=\"400\"/>", Same, "unknown element <mas> in <inertial>", "<mass>"),
            (
                mass,
                "<mass",
                "<mass value=\"1\"/>\n<mass value=\"2\"/>",
                Below(1),
                "a second <mass>",
                "only one",
            ),
            (
                mass,
                "<mass",
                "<mass value=\"1\" value=\"2\"/>",
                Same,
                "a second value of <mass>",
                "one of them",
            ),
            (mass, "<mass", "<mass/>", Same, "<mass> has no value", "value=\"...\""),
            (mass, "<inertia ", "<inertia ixx=\"1\"/>", Same, "<inertia> has no ixy", "ixy=\"...\""),
        ],
    );
    let sandbox = Sandbox::new();
    let line = sandbox.replace_line(URDF, mass, "<mass", "");
    let place = format!("{URDF}:{}: ", line - 2);
    let arguments = ["identifiability", "--model", ROBOT];
    assert_refused(&sandbox, &arguments, &place, "<inertial> has no <mass>", "<mass .../>");
}

/// A measurement file of the shipped robot in calibrig's own columns, from a simulated session: header and 60 rows of cells.
fn measured() -> Vec<Vec<String>> {
    static TEXT: OnceLock<String> = OnceLock::new();
    let text = TEXT.get_or_init(|| {
        let sandbox = Sandbox::new();
        let scenario = load_scenario(&sandbox.path(SCENARIO)).expect("the shipped scenario");
        let simulation = simulate(&scenario, 1, 0, PlantKind::Rapier, |_, _| {}).expect("a session");
        let joints: Vec<JointKind> =
            scenario.robot.model.kinematics.links.iter().map(|link| link.kind).collect();
        let set = &simulation.sets[0].measurements;
        write_measurements(&sandbox.path("set.csv"), set, &joints).expect("written");
        sandbox.read("set.csv")
    });
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

fn csv_text(rows: &[Vec<String>]) -> String {
    rows.iter().map(|row| row.join(",") + "\n").collect()
}

/// A sandbox with `name`, the measurement file.
pub fn with_measurements(name: &str) -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.write(name, csv_text(&measured()));
    sandbox
}

const IDENTIFY: [&str; 7] = ["identify", "--model", ROBOT, "--measurements", "set.csv", "--out", "out"];

#[test]
fn a_user_has_a_mistake_in_a_measurement_file() {
    type Change = fn(&mut Vec<Vec<String>>);
    let column =
        |name: &str| measured()[0].iter().position(|n| n == name).unwrap_or_else(|| panic!("no {name}"));
    // The changes below count on it.
    assert_eq!((column("q2_rad"), column("pose")), (4, 0));
    let cases: &[(Change, usize, &str, &str)] = &[
        (|rows| drop(rows[3].pop()), 4, "is missing", "32 values, as the header has"),
        (
            |rows| rows[3].push("7".to_owned()),
            4,
            "the row has 33 columns, the header 32",
            "32 values, as the header has",
        ),
        (|rows| rows[3][4] = "abc".to_owned(), 4, "column q2_rad is \"abc\"", "a number"),
        (|rows| rows[3][4] = "NaN".to_owned(), 4, "column q2_rad is \"NaN\"", "a finite number"),
        (|rows| rows[3][4] = "inf".to_owned(), 4, "column q2_rad is \"inf\"", "a finite number"),
        (|rows| rows[3][4] = "1e999".to_owned(), 4, "column q2_rad is \"1e999\"", "a finite number"),
        (|rows| rows[3][4] = String::new(), 4, "column q2_rad is empty", "a number"),
        (|rows| rows[3][4] = "\"0,5\"".to_owned(), 4, "column q2_rad is \"0,5\"", "a decimal point"),
        (|rows| rows[3][4] = "\"0.5".to_owned(), 4, "the quote is not closed", "quotes in pairs"),
        (|rows| rows[60][0] = "1.5".to_owned(), 61, "column pose is \"1.5\"", "a whole number"),
        (|rows| rows[60][0] = "-1".to_owned(), 61, "column pose is \"-1\"", "a whole number"),
        (|rows| rows[0][4] = "q2".to_owned(), 1, "column q2_rad is missing", "a column q2_rad"),
        (|rows| rows[0][4] = "q2_deg".to_owned(), 1, "column q2_rad is missing", "a column q2_rad"),
        (|rows| rows[0][4] = "q3_rad".to_owned(), 1, "column q2_rad is missing", "a column q2_rad"),
        (|rows| rows[0].push("pose".to_owned()), 1, "column pose appears twice", "distinct"),
        (|rows| rows.truncate(1), 1, "no measurements below the header", "one row of numbers"),
        (Vec::clear, 1, "the file is empty", "names of the columns"),
        (|rows| drop(rows.remove(0)), 1, "column", "column"),
        (|rows| rows.truncate(3), 3, "fewer than three", "at least three poses"),
        (|rows| rows.truncate(5), 5, "12 measured coordinates and priors for", "more poses"),
        (
            |rows| {
                for i in 2..61 {
                    rows[i] = rows[1].clone();
                }
            },
            2,
            "all on one line",
            "at least three poses",
        ),
    ];
    for (change, line, message, expected) in cases {
        let sandbox = Sandbox::new();
        let mut rows = measured();
        change(&mut rows);
        sandbox.write("set.csv", csv_text(&rows));
        assert_refused(&sandbox, &IDENTIFY, &format!("set.csv:{line}: "), message, expected);
        // In the file to verify on they are found as well, but for the number of poses, of which one is enough there.
        if !expected.contains("poses") {
            sandbox.write("good.csv", csv_text(&measured()));
            let arguments = [
                "identify",
                "--model",
                ROBOT,
                "--measurements",
                "good.csv",
                "--verify",
                "set.csv",
                "--out",
                "out",
            ];
            assert_refused(&sandbox, &arguments, &format!("set.csv:{line}: "), message, expected);
        }
    }
}

#[test]
fn a_user_has_no_measurement_file() {
    let sandbox = Sandbox::new();
    assert_refused(&sandbox, &IDENTIFY, "cannot read set.csv: ", "No such file", "a text file in UTF-8");
    sandbox.make_folder("set.csv");
    assert_refused(&sandbox, &IDENTIFY, "cannot read set.csv: ", "it is a folder", "a text file in UTF-8");
    let sandbox = Sandbox::new();
    sandbox.write("set.csv", [&[0x89], "PNG\r\n\0\0".as_bytes()].concat());
    assert_refused(&sandbox, &IDENTIFY, "set.csv:2: ", "a zero byte, which text cannot contain", "a text");
}

#[test]
fn a_user_has_a_mistake_in_a_column_map() {
    const MAP: &str = "models/ur5/columns.toml";
    let header = "step_order,joint_1,joint_2,joint_3,joint_4,joint_5,joint_6,x_t,y_t,z_t,x_dif,y_dif,z_dif";
    let rows = (0..40)
        .map(|i| {
            let s = |k: u32| f64::from(i * k % 37);
            format!(
                "{i},{},{},{},{},{},{},{},{},{},0.1,0.2,0.3\n",
                s(3),
                s(5),
                s(7),
                s(11),
                s(13),
                s(17),
                s(2),
                s(19),
                s(23)
            )
        })
        .collect::<Vec<_>>()
        .concat();
    let five = "columns = [\"joint_1\", \"joint_2\", \"joint_3\", \"joint_4\", \"joint_5\"]";
    let twice = "columns = [\"joint_1\", \"joint_2\", \"joint_3\", \"joint_4\", \"joint_5\", \"joint_5\"]";
    let mistakes: &[Mistake] = &[
        (
            "[joints]",
            "revolute_unit",
            "",
            Header,
            "missing key `revolute_unit` in [joints]",
            "deg, rad, mrad, urad, arcsec, gon or rev",
        ),
        ("[joints]", "revolute_unit", "revolute_unit = \"grad\"", Same, "revolute_unit is \"grad\"", "`deg`"),
        (
            "[joints]",
            "columns",
            five,
            Same,
            "joints.columns names 5 columns, but the robot has 6",
            "one column per joint",
        ),
        (
            "[joints]",
            "columns",
            twice,
            Same,
            "column \"joint_5\" is named twice",
            "a different column for each",
        ),
        ("[joints]", "columns", "colums = []", Same, "unknown key `colums`", "`columns`"),
        (
            "[joints]",
            "columns",
            "columns = 6",
            Same,
            "joints.columns names 1 columns",
            "one column per joint",
        ),
        ("[joints]", "columns", "columns = 6.5", Same, "joints.columns is 6.5", "a signed sum"),
        ("[position]", "unit", "", Header, "missing key `unit` in [position]", "unit = mm, m"),
        ("[position]", "unit", "unit = \"foot\"", Same, "position.unit is \"foot\"", "`mm`"),
        ("[position]", "system", "system = \"polar\"", Same, "position.system is \"polar\"", "`spherical`"),
        ("[position]", "x", "x = true", Same, "position.x is true", "a signed sum"),
        ("[position]", "z", "", Header, "[position] has no z", "the key z"),
        ("[columns]", "pose", "pse = \"step_order\"", Same, "unknown key `pse`", "`pose`"),
        ("", "schema", "", First, "missing key `schema`", "`schema`"),
        ("", "schema", "schema = \"calibrig.columns/2\"", Same, "columns/2", "\"calibrig.columns/1\""),
    ];
    for (marker, start, with, line, message, expected) in mistakes {
        let sandbox = Sandbox::new();
        sandbox.write("set.csv", format!("{header}\n{rows}"));
        let changed = sandbox.replace_line(MAP, marker, start, with);
        let place = format!("{MAP}:{}: ", expected_line(&sandbox, MAP, changed, *line));
        let arguments = ["identify", "--model", "models/ur5/robot.toml", "--measurements", "set.csv"];
        assert_refused(&sandbox, &arguments, &place, message, expected);
        sandbox.write("map.toml", sandbox.read(MAP));
        let arguments = [&arguments[..], &["--columns", "map.toml"]].concat();
        assert_refused(&sandbox, &arguments, &place.replace(MAP, "map.toml"), message, expected);
    }
    let sandbox = Sandbox::new();
    sandbox.write("set.csv", format!("{header}\n{rows}"));
    let arguments = [
        "identify",
        "--model",
        "models/ur5/robot.toml",
        "--measurements",
        "set.csv",
        "--columns",
        "map.toml",
    ];
    assert_refused(&sandbox, &arguments, "cannot read map.toml: ", "No such file", "a text file in UTF-8");
    // The map names a column that the file does not have.
    sandbox.write("set.csv", format!("{}\n{rows}", header.replace("x_dif", "dx")));
    assert_refused(
        &sandbox,
        &arguments[..5],
        "set.csv:1: ",
        "column x_dif is missing",
        "a column x_dif; found step_order",
    );
}

/// Sections of effects, each with one thing wrong: the line of the error in the section, its message, and what was expected.
#[test]
fn a_user_gives_an_effect_that_no_machine_has() {
    const THERMAL: &str = "[effects.thermal]\nreference_c = 20\nstart_c = 21\n";
    const GROWTH: &str =
        "[[effects.thermal.link]]\njoint = \"shoulder\"\naxis = \"x\"\nlength_mm = 1350\nlag_s = 900\n";
    let hot = THERMAL.replace("21", "210");
    let drifting = format!("{THERMAL}drift_c_per_h = 2000\n{GROWTH}expansion_ppm_per_k = 12");
    let metres = format!("{THERMAL}{GROWTH}expansion_per_k = 12e-6");
    for (section, line, message, expected) in [
        ("[effects.slip]", 1, "unknown key `slip`", "`backlash`"),
        (
            "[effects.backlash]\nenabled = true",
            1,
            "[effects.backlash] has no entry",
            "[[effects.backlash.joint]]",
        ),
        ("[effects.backlash]\nenabled = 1", 2, "effects.backlash.enabled is 1", "true or false"),
        (
            "[[effects.backlash.joint]]\njoint = \"waist\"\ngap_arcsec = -1",
            3,
            "gap_arcsec is -1",
            "zero or more",
        ),
        ("[[effects.backlash.joint]]\njoint = \"waist\"\ngap_um = 1", 3, "which is revolute", "gap_arcsec"),
        (
            "[[effects.backlash.joint]]\njoint = \"waist\"\ngap = 1",
            3,
            "unknown key `gap`",
            "`gap_um` or `gap_arcsec`: the unit",
        ),
        (
            "[[effects.backlash.joint]]\njoint = \"wrist 2\"\ngap_arcsec = 1",
            2,
            "no joint \"wrist 2\"",
            "rail, waist",
        ),
        (
            "[[effects.ratio.joint]]\njoint = \"rail\"\nrelative_ppm = 1e5",
            3,
            "relative_ppm is 100000",
            "at most 10000 ppm",
        ),
        (
            "[[effects.repeatability.joint]]\njoint = \"rail\"\nsigma_um = nan",
            3,
            "sigma_um is nan",
            "a finite number",
        ),
        (
            "[effects.rail]\njoint = \"waist\"\nwavelength_mm = 800",
            2,
            "effects.rail.joint \"waist\" is not a rail",
            "the first joint",
        ),
        ("[effects.rail]\njoint = \"rail\"\nwavelength_mm = -800", 3, "wavelength_mm is -800", "above zero"),
        (hot.as_str(), 3, "effects.thermal.start_c is 210", "-20 to 60 degrees"),
        // In the course of the session.
        (drifting.as_str(), 4, "the air temperature leaves -20 to 60 degC", "or a shorter session"),
        (THERMAL, 1, "has nothing that grows", "[[effects.thermal.link]]"),
        (metres.as_str(), 9, "unknown key `expansion_per_k`", "`expansion_ppm_per_k`"),
    ] {
        let sandbox = Sandbox::new();
        let text = sandbox.read(SCENARIO);
        sandbox.write(SCENARIO, format!("{text}\n{section}\n"));
        let place = format!("{SCENARIO}:{}: ", text.lines().count() + 1 + line);
        assert_refused(&sandbox, &["check", SCENARIO], &place, message, expected);
    }
}

/// A tool force that no pose withstands is told with the pose, and nothing is measured.
#[test]
fn a_user_pushes_the_robot_over() {
    let sandbox = Sandbox::new();
    let push = "[[as_built.load]]\nname = \"push\"\njoint = \"wrist\"\nx_mm = 0\ny_mm = 0\nz_mm = 0\nforce_y_n = -900000\n";
    sandbox.write(SCENARIO, format!("{}\n{push}", sandbox.read(SCENARIO)));
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    assert_eq!((ended.code, ended.stdout.as_str()), (Some(1), ""), "{ended:?}");
    assert!(
        ended.stderr.contains("identification set, pose 0: the plant: unstable equilibrium"),
        "{ended:?}"
    );
    assert!(!sandbox.path("out").exists(), "something was left behind");
}

#[test]
fn the_numbers_are_of_no_machine() {
    for (marker, key, value) in [
        ("joint = \"rail\"", "delta_d_mm", "1e15"),
        ("joint = \"shoulder\"", "mass_factor", "1e15"),
        ("joint = \"shoulder\"", "stiffness_factor", "1e-15"),
        ("joint = \"shoulder\"", "delta_alpha_rad", "1e15"),
        (TRACKER, "nest_sigma_um", "1e15"),
        (TRACKER, "target_sigma_um", "1e15"),
        (TRACKER, "target_sigma_um", "1e-15"),
        (TRACKER, "random_fraction", "1e15"),
        (TRACKER, "systematic_fraction", "1e-15"),
        (TRACKER, "x_mm", "-1e15"),
        (IDENTIFICATION, "unmodelled_sigma_um", "1e15"),
    ] {
        let sandbox = Sandbox::new();
        sandbox.set(marker, key, value);
        let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
        assert!(matches!(ended.code, Some(0 | 1 | 3)), "{key} = {value}: {ended:?}");
        assert_eq!(ended.code == Some(1), ended.stdout.is_empty(), "{key} = {value}: {ended:?}");
        if ended.code == Some(1) {
            // What the scenario is told of beforehand may stand before it.
            let error = format!("error: {SCENARIO}:");
            assert!(ended.stderr.lines().any(|line| line.starts_with(&error)), "{ended:?}");
            assert!(!sandbox.path("out").exists(), "{key} = {value}");
        }
    }
}

/// No line may be one without which the reader loses its way.
#[test]
fn a_file_without_one_of_its_lines_is_read_or_refused_with_a_place() {
    for (file, beside) in [(SCENARIO, false), (ROBOT, true), (URDF, true)] {
        let sandbox = Sandbox::new();
        let text = sandbox.read(file);
        let lines: Vec<_> = text.lines().collect();
        for left_out in 0..lines.len() {
            let without = [&lines[..left_out], &lines[left_out + 1..]].concat();
            // And the file that ends before the line.
            for (kind, lines) in [("without", without.as_slice()), ("up to", &lines[..left_out])] {
                sandbox.write(file, lines.join("\n"));
                let read = if beside {
                    load_robot(&sandbox.path(ROBOT)).map(drop)
                } else {
                    load_scenario(&sandbox.path(SCENARIO)).map(drop)
                };
                let Err(error) = read else { continue };
                let InputError::Invalid { message, line, help, .. } = &error else {
                    panic!("{file} {kind} line {}: {error}", left_out + 1)
                };
                let context = format!("{file} {kind} line {}: {line}: {message}: {help:?}", left_out + 1);
                assert!(help.as_deref().is_some_and(|help| !help.is_empty()), "{context}");
                // A robot that lost a line may be at odds with its URDF, and the other way round.
                let named = [SCENARIO, ROBOT, URDF].into_iter().find(|file| error.to_string().contains(file));
                let named = named.unwrap_or_else(|| panic!("{context}: no file is named: {error}"));
                assert!((1..=sandbox.read(named).lines().count().max(1)).contains(line), "{context}");
            }
        }
    }
}

#[test]
fn a_user_describes_an_instrument_that_there_is_not() {
    let none_passes = "passes its own acceptance test";
    in_scenario(&[
        (
            TRACKER,
            "preset",
            "preset = \"at50\"",
            Same,
            "tracker.preset is \"at50\"",
            "one of: at500, at960, vantage, gts3800",
        ),
        (TRACKER, "systematic_fraction", "systematic_fraction = 5", Same, none_passes, "0.2 are usual"),
        (TRACKER, "noise", "miss_fraction = 1.5", Same, "tracker.miss_fraction is 1.5", "below 1"),
        (
            TRACKER,
            "noise",
            "range_limits_m = [9, 2]",
            Same,
            "tracker.range_limits_m is [9, 2]",
            "lower of the two",
        ),
        (TRACKER, "noise", "air_um_per_m = -1", Same, "tracker.air_um_per_m is -1", "zero or more"),
        (
            "[tracker.environment]",
            "temperature_c",
            "temperature_c = 400",
            Same,
            "tracker.environment.temperature_c is 400",
            "-40 to 60",
        ),
        (
            "[tracker.environment]",
            "pressure_hpa",
            "pressure_hpa = 101325",
            Same,
            "tracker.environment.pressure_hpa is 101325",
            "500 to 1200",
        ),
        (
            "[tracker.environment]",
            "gradient_k_per_m",
            "gradient_k_per_m = 300",
            Header,
            "gradient of the temperature in K/m is 300",
            "-20 to 20",
        ),
        (
            "[tracker.drift]",
            "warm_up_um",
            "warm_up_um = [8, 2]",
            Same,
            "tracker.drift.warm_up_um is [8, 2]",
            "the lower of the two first",
        ),
        (
            "[tracker.drift]",
            "walk_um",
            "walk_um_per_root_h = nan",
            Same,
            "walk_um_per_root_h is nan",
            "finite",
        ),
        (
            "[tracker.smr]",
            "centring_um",
            "centring_um = -3",
            Same,
            "tracker.smr.centring_um is -3",
            "zero or more",
        ),
        (
            "[tracker.smr]",
            "acceptance_deg",
            "acceptance_deg = 120",
            Header,
            "acceptance angle of the SMR",
            "at most a right angle",
        ),
    ]);
}

#[test]
fn a_user_measures_where_the_instrument_does_not_work() {
    let sandbox = Sandbox::new();
    sandbox.set(TRACKER, "preset", "\"vantage\"");
    let line = sandbox.set("[tracker.environment]", "temperature_c", "55");
    let message = "tracker.environment.temperature_c is 55";
    let place = format!("{SCENARIO}:{line}: ");
    assert_refused(
        &sandbox,
        &["check", SCENARIO],
        &place,
        message,
        "expected -15 to 50, the temperatures at which",
    );
}

#[test]
fn a_user_asks_for_the_test_of_an_instrument_that_there_is_not() {
    let sandbox = Sandbox::new();
    let names = "at500, at960, vantage, gts3800";
    assert_refused(&sandbox, &["tracker-acceptance", "at50"], "at50: ", "no file and no preset", names);
    sandbox.set(TRACKER, "preset", "\"AT500\"");
    let ended = sandbox.run(["tracker-acceptance", SCENARIO]);
    assert!(ended.code == Some(1) && ended.stderr.contains("tracker.preset is \"AT500\""), "{ended:?}");
}

/// One instrument that fails is a result to look at; several are a statement about the kind.
#[test]
fn an_instrument_that_fails_its_acceptance_test_ends_with_three() {
    let sandbox = Sandbox::new();
    let run = |arguments: &[&str]| sandbox.run([&["tracker-acceptance"], arguments].concat());
    assert_eq!(run(&["at500"]).code, Some(0));
    sandbox.set(TRACKER, "random_fraction", "0.5");
    sandbox.set(TRACKER, "systematic_fraction", "0");
    let ended = run(&[SCENARIO, "--out", "out"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(ended.stdout.contains("does not pass"), "{ended:?}");
    for file in ["acceptance.html", "acceptance.svg", "acceptance.json"] {
        assert!(!sandbox.read(&format!("out/{file}")).is_empty(), "{file}");
    }
    let many = run(&[SCENARIO, "--instruments", "50", "--json"]);
    assert_eq!(many.code, Some(0), "{many:?}");
    let json = many.json();
    assert_eq!(json["schema"], "calibrig.acceptance/1");
    assert!(json["pass_fraction"].as_f64().is_some_and(|share| share <= 0.1), "{json}");
}
