//! `calibrig compensate`: commands with which the identified robot's tool is where it should be. What it says is checked from its files, with nothing but
//! forward predictions: the code that corrects is not asked.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;
use std::sync::LazyLock;
use std::time::Instant;

use calibrig::compensation::Raster;
use calibrig::files::{ColumnMap, Source, commanded_joints, parse_goal_file, parse_measurements};
use calibrig::geometry::Transform;
use calibrig::handover::{EstimateFile, model_sha256};
use calibrig::identification::{Mode, Predictor};
use calibrig::inverse::{Goal, InverseKinematics, InverseOptions, Tool};
use calibrig::kinematics::{forward_kinematics, joints_from_command};
use calibrig::measurement::Motion;
use calibrig::model::{CalibrationModel, JointKind, Payload, PoseQuery};
use calibrig::nalgebra::{Rotation3, Vector3};
use calibrig::pipeline::{self, Outcome};
use calibrig::recording::write_mcap;
use calibrig::scenario::load_scenario;

use crate::a_user_reproduces_the_paper::paper;
use crate::sandbox::{Ended, Sandbox, assert_refused};

/// The published session: four-bar, deflection, terms that depend on the side of approach.
static PAINTER: LazyLock<Outcome> = LazyLock::new(|| pipeline::run(&paper(), 5, |_, _| {}).expect("a run"));
static UR5: LazyLock<Outcome> = LazyLock::new(|| {
    let scenario = load_scenario(Path::new("scenarios/zoo/ur5.toml")).expect("a shipped scenario");
    pipeline::run(&scenario, 1, |_, _| {}).expect("a run")
});

type Row = BTreeMap<String, String>;

/// A sandbox with the estimate of an outcome as `estimate.json`.
fn bench(outcome: &Outcome, mode: Option<Mode>) -> (Sandbox, EstimateFile) {
    let sandbox = Sandbox::new();
    let text = EstimateFile::of(outcome, mode).expect("an estimate").text().expect("JSON");
    sandbox.write("estimate.json", text);
    let read = EstimateFile::read(&sandbox.path("estimate.json")).expect("as written");
    (sandbox, read)
}

fn rows(text: &str) -> Vec<Row> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    reader.deserialize().map(|row| row.expect("a row")).collect()
}

fn number(row: &Row, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|error| panic!("{column}: {error} {row:?}"))
}

fn place(row: &Row, columns: [&str; 3]) -> Vector3<f64> {
    Vector3::from(columns.map(|column| 1e-3 * number(row, column)))
}

/// Commands of a row of `compensated.csv`, m or rad.
fn command(row: &Row, model: &CalibrationModel, prefix: &str) -> Vec<f64> {
    let links = model.kinematics.links.iter().zip(1..);
    let of = |(link, number): (&calibrig::model::CraigLink, usize)| match link.kind {
        JointKind::Revolute => self::number(row, &format!("{prefix}{number}_deg")).to_radians(),
        JointKind::Prismatic => 1e-3 * self::number(row, &format!("{prefix}{number}_mm")),
    };
    links.map(of).collect()
}

fn approach(row: &Row, joints: usize) -> Vec<i8> {
    (1..=joints).map(|number| row[&format!("approach{number}")].parse().expect("a sign")).collect()
}

/// Where the rigid nominal robot has its first target.
fn nominal_tool(estimate: &EstimateFile, command: &[f64]) -> Transform {
    let robot = &estimate.estimate.robot;
    let mut joints = vec![0.0; command.len()];
    let (chain, actuators) = (&robot.nominal.kinematics, robot.nominal.actuators.clone().without_linkage());
    joints_from_command(chain, &actuators, command, &mut joints).expect("a pose");
    let flange = forward_kinematics(chain, &joints).expect("joints");
    flange * Transform::from_parts(robot.targets[0].into(), Rotation3::identity())
}

/// A command at these shares of the way between the lowest and highest ones that were measured.
fn within(estimate: &EstimateFile, shares: &[f64]) -> Vec<f64> {
    let ends = estimate.region.command_min.iter().zip(&estimate.region.command_max);
    ends.zip(shares.iter().cycle()).map(|((low, high), share)| low + share * (high - low)).collect()
}

fn compensate(sandbox: &Sandbox, rest: &[&str]) -> Ended {
    sandbox.run([&["compensate", "--estimate", "estimate.json"], rest].concat())
}

/// In the measured region, as positions, directions or poses.
fn points(estimate: &EstimateFile, form: &str, count: usize) -> String {
    let mut text = format!("name,x_mm,y_mm,z_mm{form}\n");
    for k in 0..count {
        let shares: Vec<f64> = (0..7).map(|j| 0.5 + 0.35 * (1.7 * (k * 7 + j) as f64).sin()).collect();
        let tool = nominal_tool(estimate, &within(estimate, &shares));
        let [x, y, z] = [0, 1, 2].map(|axis| 1e3 * tool.translation.vector[axis]);
        let matrix = tool.rotation.matrix();
        let held: Vec<f64> = match form.matches(',').count() {
            0 => Vec::new(),
            3 => matrix.column(2).iter().copied().collect(),
            _ => matrix.transpose().iter().copied().collect(),
        };
        // Writing to a String cannot fail.
        let _ = write!(text, "P{k},{x:?},{y:?},{z:?}");
        for v in held {
            let _ = write!(text, ",{v:?}");
        }
        text += "\n";
    }
    text
}

const AXIS: &str = ",axis_x,axis_y,axis_z";
const MATRIX: &str = ",r11,r12,r13,r21,r22,r23,r31,r32,r33";

#[test]
fn the_identified_robot_is_at_its_goals_by_the_files_alone() {
    for (outcome, mode) in [
        (&*PAINTER, None),
        (&*PAINTER, Some(Mode::WithGravity)),
        (&*PAINTER, Some(Mode::OnlyCalibration)),
        (&*UR5, None),
    ] {
        let (sandbox, estimate) = bench(outcome, mode);
        let robot = &estimate.estimate.robot;
        let count = robot.nominal.kinematics.joint_count();
        let signs: Vec<i8> = (0..count).map(|j| if j % 2 == 0 { 1 } else { -1 }).collect();
        let stated = signs.iter().map(ToString::to_string).collect::<Vec<_>>().join(",");
        for form in ["", AXIS, MATRIX] {
            sandbox.write("points.csv", points(&estimate, form, 12));
            let ended = compensate(
                &sandbox,
                &["--targets", "points.csv", "--approach", &stated, "--out", "out", "--json"],
            );
            assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
            let json = ended.json();
            assert_eq!(
                (&json["schema"], &json["kind"]),
                (&"calibrig.compensation/1".into(), &"points".into())
            );
            assert_eq!(
                json.to_string(),
                serde_json::from_str::<serde_json::Value>(&sandbox.read("out/compensation.json"))
                    .expect("JSON")
                    .to_string()
            );
            let asked = rows(&sandbox.read("points.csv"));
            let found = rows(&sandbox.read("out/compensated.csv"));
            let mut predictor = Predictor::new(robot).expect("a robot");
            let (mut worst, mut before, mut turned, mut met) = (0.0_f64, 0.0_f64, 0.0_f64, 0);
            for (row, asked) in found.iter().zip(&asked) {
                let goal = place(asked, ["x_mm", "y_mm", "z_mm"]);
                assert!(
                    (place(row, ["x_mm", "y_mm", "z_mm"]) - goal).norm() < 1e-15
                        && row["name"] == asked["name"]
                );
                if row["status"] != "met" {
                    assert!(row["note"].contains("misses it by"), "{row:?}");
                    continue;
                }
                met += 1;
                assert_eq!(approach(row, count), signs);
                let corrected = command(row, &robot.nominal, "q");
                let at = PoseQuery::at(&corrected).approached(&signs);
                let there = predictor.in_base(at).expect("a pose");
                worst = worst.max((there - goal).norm());
                // What the nominal command would do: it is right for the rigid robot, and off by as much as is stated.
                let nominal = command(row, &robot.nominal, "nominal");
                let rigid = nominal_tool(&estimate, &nominal);
                assert!((rigid.translation.vector - goal).norm() < 1e-9, "{row:?}");
                let without =
                    predictor.in_base(PoseQuery::at(&nominal).approached(&signs)).expect("a pose") - goal;
                let told = place(row, ["before_x_mm", "before_y_mm", "before_z_mm"]);
                assert!((without - told).norm() < 1e-9, "{without} {told}");
                before = before.max(without.norm());
                let sigma = 1e-3 * number(row, "sigma_mm");
                assert!(sigma > 1e-6 && sigma < 0.05, "{row:?}");
                // The rotation, by three points of the tool: targets on the flange beside it.
                if form == MATRIX {
                    let mut beside = robot.clone();
                    let rotation =
                        Rotation3::from_matrix_unchecked(calibrig::nalgebra::Matrix3::from_fn(|i, j| {
                            number(asked, &format!("r{}{}", i + 1, j + 1))
                        }));
                    for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
                        beside.targets[0] = robot.targets[0] + axis;
                        let there = Predictor::new(&beside).expect("a robot").in_base(at).expect("a pose");
                        turned = turned.max((there - goal - rotation * axis).norm());
                    }
                }
            }
            println!(
                "{} {} {form}: {met} of {} met, {:.1e} m left of {:.2} mm, turned by {turned:.1e}",
                estimate.robot.name,
                robot.mode.key(),
                found.len(),
                worst,
                1e3 * before
            );
            assert!(
                met >= 6 && worst < 1e-6 && turned < 2e-6 && before > 1e-4,
                "{met} {worst} {turned} {before}"
            );
            assert!(number(&found[0], "left_um") < 1.0);
        }
    }
}

/// What is commanded is read as calibrig's own columns.
#[test]
fn corrected_commands_are_read_as_measured_ones() {
    let (sandbox, estimate) = bench(&PAINTER, None);
    sandbox.write("points.csv", points(&estimate, "", 6));
    let ended = compensate(&sandbox, &["--targets", "points.csv", "--out", "out"]);
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    let model = &estimate.estimate.robot.nominal;
    let mut lines = sandbox.read("out/commands.csv").lines().map(str::to_owned).collect::<Vec<_>>();
    for (index, line) in lines.iter_mut().enumerate() {
        *line += if index == 0 { ",x_m,y_m,z_m" } else { ",1.0,2.0,3.0" };
    }
    let source = Source::new("commands.csv", lines.join("\n") + "\n");
    let read =
        parse_measurements(&source, &ColumnMap::default(), &commanded_joints(model)).expect("own columns");
    let found = rows(&sandbox.read("out/compensated.csv"));
    assert_eq!(read.set.observations.len(), found.iter().filter(|row| row["status"] == "met").count());
    for (observation, row) in read.set.observations.iter().zip(&found) {
        for (a, b) in observation.command.iter().zip(command(row, model, "q")) {
            assert!((a - b).abs() <= 1e-15 * (1.0 + b.abs()), "{a} {b}");
        }
    }
}

/// A panel in front of the tool in the middle of the measured region, m.
fn panel(estimate: &EstimateFile, [width, height]: [f64; 2], pitch: f64, spacing: f64, speed: f64) -> String {
    let middle = nominal_tool(estimate, &within(estimate, &[0.5]));
    let gun = middle.rotation * Vector3::z();
    let along = (Vector3::z() - gun * gun.z).normalize();
    let up = gun.cross(&along);
    let centre = middle.translation.vector + 0.2 * gun;
    let corner = |x: f64, y: f64| {
        let at = 1e3 * (centre + x * width * along - y * height * up);
        format!("[{:.3}, {:.3}, {:.3}]", at.x, at.y, at.z)
    };
    let corners = [corner(-0.5, -0.5), corner(0.5, -0.5), corner(0.5, 0.5), corner(-0.5, 0.5)].join(", ");
    format!(
        "schema = \"calibrig.goals/1\"\n[raster]\ncorners_mm = [{corners}]\npitch_mm = {}\nspacing_mm = {}\nstandoff_mm = 200\nspeed_mm_per_s = {}\n",
        1e3 * pitch,
        1e3 * spacing,
        1e3 * speed
    )
}

/// Largest second difference of any actuator, m or rad.
fn bend(commands: &[Vec<f64>]) -> f64 {
    let second = |w: &[Vec<f64>]| {
        (0..w[0].len()).map(|a| (w[0][a] - 2.0 * w[1][a] + w[2][a]).abs()).fold(0.0, f64::max)
    };
    commands.windows(3).map(second).fold(0.0, f64::max)
}

/// Ten metres in ten thousand points: every command gives its place, from the side from which the commands themselves come; no joint is too fast or jumps.
#[test]
fn a_raster_of_ten_metres_is_met_without_a_jump() {
    for mode in [Mode::ElastoGeometric, Mode::Extended] {
        let (sandbox, estimate) = bench(&PAINTER, Some(mode));
        let robot = &estimate.estimate.robot;
        let count = robot.nominal.kinematics.joint_count();
        sandbox.write("panel.toml", panel(&estimate, [1.02, 0.8], 0.1, 0.998e-3, 0.25));
        // The time is told.
        #[allow(clippy::disallowed_methods)]
        let began = Instant::now();
        let ended = compensate(
            &sandbox,
            &["--targets", "panel.toml", "--model", "models/spray_painter/robot.toml", "--out", "out"],
        );
        let seconds = began.elapsed().as_secs_f64();
        assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
        assert!(!ended.stderr.contains("too fast") && !ended.stderr.contains("jump"), "{}", ended.stderr);
        let found = rows(&sandbox.read("out/compensated.csv"));
        assert!(found.len() >= 10_000, "{}", found.len());
        // The goals are those of the raster.
        let file = parse_goal_file(Source::new("panel.toml", sandbox.read("panel.toml"))).expect("sound");
        let stated = file.raster.expect("a raster");
        let raster = Raster {
            corners: stated.corners,
            pitch: stated.pitch,
            spacing: stated.spacing,
            standoff: stated.standoff,
        };
        let goals = raster.goals().expect("a panel");
        assert_eq!(goals.len(), found.len());

        let mut predictor = Predictor::new(robot).expect("a robot");
        let mut motion: Option<Motion> = None;
        let (mut worst, mut wavering, mut length) = (0.0_f64, 0, 0.0);
        let mut commands: [Vec<Vec<f64>>; 2] = [Vec::new(), Vec::new()];
        // As the URDF has them; the elbow's motor is not its joint.
        let limits = [1.0, 0.8, 0.8, f64::INFINITY, 1.0, 2.0, 2.0];
        let mut fastest = [0.0_f64; 7];
        for (row, goal) in found.iter().zip(&goals) {
            assert_eq!(row["status"], "met", "{row:?}");
            let at = command(row, &robot.nominal, "q");
            let sides = match &mut motion {
                Some(motion) => {
                    motion.go_to(&at, 1e-7);
                    motion.clone()
                }
                None => motion.insert(Motion::at(&at)).clone(),
            };
            let time = number(row, "time_s");
            let mut pose = PoseQuery::at(&at).approached(&sides.approach).moved(&sides.since_reversal);
            pose.time = time;
            let wavers = row["marks"].contains("wavers");
            wavering += usize::from(wavers);
            if !wavers {
                assert!(commands[1].is_empty() || approach(row, count) == sides.approach, "{row:?}");
                worst = worst.max((predictor.in_base(pose).expect("a pose") - goal.position()).norm());
            }
            if let Some(last) = commands[1].last() {
                let before = &found[commands[1].len() - 1];
                let seconds = time - number(before, "time_s");
                for axis in 0..count {
                    fastest[axis] = fastest[axis].max((at[axis] - last[axis]).abs() / seconds);
                    assert!(
                        (at[axis] - last[axis]).abs() <= limits[axis] * seconds * (1.0 + 1e-9),
                        "{axis}: {row:?}"
                    );
                }
                length += 0.25 * seconds;
            }
            commands[0].push(command(row, &robot.nominal, "nominal"));
            commands[1].push(at);
        }
        let [nominal, corrected] = commands.each_ref().map(|commands| bend(commands));
        println!(
            "{}: {} points, {length:.2} m in {seconds:.1} s: {worst:.1e} m left, {wavering} waver; second differences {corrected:.2e}, nominal {nominal:.2e} ({:.3} times); fastest {fastest:.3?} m/s or rad/s",
            mode.key(),
            found.len(),
            corrected / nominal
        );
        assert!(worst < 1e-6, "{worst}");
        assert!(wavering * 20 < found.len(), "{wavering}");
        // Identification on two busy cores included, ten thousand points take a few seconds.
        assert!(seconds < 120.0, "{seconds}");
        match mode {
            // Nothing that changes with the side: as smooth as the nominal path, and what the deflection adds.
            Mode::ElastoGeometric => {
                assert!(wavering == 0 && corrected < 1.2 * nominal + 1e-7, "{corrected} {nominal}");
            }
            // Backlash is taken up where an actuator turns round: twice its size from one point to the next, for all of them at once at the worst, and as much back.
            _ => {
                let size: f64 = robot
                    .terms
                    .iter()
                    .filter(|(term, _)| term.family().key() == "hysteresis")
                    .map(|(_, a)| a.abs())
                    .sum();
                // A radian at the far end of the arm is moved by 3 m of a slide.
                assert!(corrected < nominal + 4.0 * 3.0 * size, "{corrected} {nominal} {size}");
            }
        }
    }
}

#[test]
fn an_estimate_and_its_recording_give_the_same() {
    let (sandbox, estimate) = bench(&UR5, None);
    write_mcap(&UR5.story(), &sandbox.path("recording.mcap")).expect("a recording");
    sandbox.write("points.csv", points(&estimate, AXIS, 8));
    let of = |input: &str, out: &str| {
        let ended = sandbox.run([
            "compensate",
            "--estimate",
            input,
            "--targets",
            "points.csv",
            "--out",
            out,
            "--json",
        ]);
        assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
        ended.json()
    };
    let (one, other) = (of("estimate.json", "one"), of("recording.mcap", "other"));
    assert_eq!(one, other);
    for name in ["compensated.csv", "commands.csv", "compensation.html"] {
        assert!(sandbox.read(&format!("one/{name}")) == sandbox.read(&format!("other/{name}")), "{name}");
    }
    let page = sandbox.read("one/compensation.html");
    assert!(page.ends_with("</html>") && page.matches("<svg").count() >= 3 && !page.contains("<script"));
    let ended = sandbox.run([
        "compensate",
        "--estimate",
        "recording.mcap",
        "--mode",
        "only_calibration",
        "--targets",
        "points.csv",
        "--json",
    ]);
    assert_eq!(ended.json()["mode"], "only_calibration", "{ended:?}");
}

/// What a controller that is told place + offset does, by the rigid robot's own kinematics.
#[test]
fn a_grid_of_offsets_is_written_with_what_lies_between() {
    let (sandbox, estimate) = bench(&UR5, None);
    let robot = &estimate.estimate.robot;
    let middle = within(&estimate, &[0.5]);
    let tool = nominal_tool(&estimate, &middle);
    let at = |by: f64| {
        let place = tool.translation.vector.map(|v| 1e3 * (v + by));
        format!("[{:.3}, {:.3}, {:.3}]", place.x, place.y, place.z)
    };
    let rows_of = |m: &Rotation3<f64>| {
        let row = |i: usize| format!("[{:?}, {:?}, {:?}]", m[(i, 0)], m[(i, 1)], m[(i, 2)]);
        format!("[{}, {}, {}]", row(0), row(1), row(2))
    };
    let file = format!(
        "schema = \"calibrig.goals/1\"\n[grid]\nlow_mm = {}\nhigh_mm = {}\npoints = [3, 2, 3]\nrotation_matrix = {}\n",
        at(-0.05),
        at(0.05),
        rows_of(&tool.rotation)
    );
    sandbox.write("box.toml", &file);
    let ended = compensate(&sandbox, &["--grid", "box.toml", "--out", "out", "--json"]);
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    let grid = &ended.json()["grid"];
    let (left, before) = (grid["interpolated"]["max_m"].as_f64(), grid["uncorrected"]["max_m"].as_f64());
    println!("left between the points {left:?} m of {before:?}");
    assert!(left < before && left > Some(0.0) && grid["interpolated"]["count"] == 4, "{grid}");
    let offsets = rows(&sandbox.read("out/grid.csv"));
    assert_eq!(offsets.len(), 18);
    assert!(!sandbox.path("out/compensated.csv").exists() && !ended.stderr.contains("compensated.csv"));
    let held = Tool::at(robot.targets[0]).expect("a tool");
    let mut nominal = InverseKinematics::new(&robot.nominal, held).expect("a robot");
    let mut predictor = Predictor::new(robot).expect("a robot");
    let options = InverseOptions {
        criterion: calibrig::inverse::Criterion::LEAST_MOTION,
        reference: Some(middle),
        ..InverseOptions::default()
    };
    for row in &offsets {
        let goal = place(row, ["x_mm", "y_mm", "z_mm"]);
        let told = goal + place(row, ["offset_x_mm", "offset_y_mm", "offset_z_mm"]);
        let goal_there = Goal::Pose(Transform::from_parts(told.into(), tool.rotation));
        let sent = nominal.solve(&goal_there, &options).expect("within reach");
        let there = predictor.in_base(&sent.command).expect("a pose");
        assert!((there - goal).norm() < 1e-6, "{row:?}: {}", (there - goal).norm());
    }
    // With goals in the same file, and both told.
    sandbox.write(
        "both.toml",
        format!(
            "{file}[raster]\n{}",
            panel(&estimate, [0.05, 0.02], 0.02, 0.005, 0.1).split("[raster]\n").nth(1).expect("a raster")
        ),
    );
    let ended = compensate(&sandbox, &["--targets", "both.toml", "--out", "out"]);
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    assert!(
        ended.stdout.contains("a path of") && ended.stdout.contains("Grid of 3 x 2 x 3 offsets"),
        "{}",
        ended.stdout
    );
    assert!(
        ended.stderr.contains("compensated.csv") && ended.stderr.contains("grid.csv"),
        "{}",
        ended.stderr
    );
}

#[test]
fn what_is_not_to_be_trusted_is_marked_and_the_rest_is_kept() {
    let (sandbox, estimate) = bench(&PAINTER, None);
    let inside = points(&estimate, "", 3);
    // One beyond the walls, one above the measured region, and points of a name.
    let far = nominal_tool(&estimate, &within(&estimate, &[0.5])).translation.vector * 1e3
        + Vector3::new(0.0, 900.0, 0.0);
    sandbox.write("points.csv", format!("{inside}far,30000,0,0\nabove,{},{},{}\n", far.x, far.y, far.z));
    let ended = compensate(&sandbox, &["--targets", "points.csv", "--trust-mm", "0.0001", "--out", "out"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    let found = rows(&sandbox.read("out/compensated.csv"));
    assert_eq!(found.len(), 5);
    assert_eq!((found[3]["status"].as_str(), found[3]["q1_mm"].as_str()), ("unreachable", ""));
    assert!(found[3]["note"].contains("misses it by") && found[3]["note"].contains("mm"), "{:?}", found[3]);
    assert!(found[0]["marks"].contains("unsure") && found[0]["status"] == "met", "{:?}", found[0]);
    assert!(
        found[4]["marks"].contains("extrapolated") && !found[4]["extrapolated"].is_empty(),
        "{:?}",
        found[4]
    );
    assert!(
        ended
            .stderr
            .contains("doubtful: 1 point is out of reach; of point 4 far (points.csv:5): the nearest"),
        "{}",
        ended.stderr
    );
    assert!(ended.stderr.contains("are less certain than 0.0001 mm (--trust-mm)"), "{}", ended.stderr);
    assert!(
        ended.stdout.contains("extrapolated: ") && ended.stdout.contains("outside the measured commands"),
        "{}",
        ended.stdout
    );
    assert_eq!(rows(&sandbox.read("out/commands.csv")).len(), 4);

    // Beyond the end of the rail: which joint, by how much.
    let end = within(&estimate, &[0.5]);
    let [mut at_end, mut before] = [end.clone(), end];
    (at_end[0], before[0]) = (4.0, 3.0);
    let along = nominal_tool(&estimate, &at_end).translation.vector
        - nominal_tool(&estimate, &before).translation.vector;
    let beyond = nominal_tool(&estimate, &at_end);
    let (place_beyond, matrix) =
        (1e3 * (beyond.translation.vector + 1.5 * along), beyond.rotation.matrix().transpose());
    let mut text =
        format!("x_mm,y_mm,z_mm{MATRIX}\n{:?},{:?},{:?}", place_beyond.x, place_beyond.y, place_beyond.z);
    matrix.iter().for_each(|v| write!(text, ",{v:?}").expect("room"));
    sandbox.write("beyond.csv", text + "\n");
    let ended = compensate(&sandbox, &["--targets", "beyond.csv", "--json"]);
    let point = &ended.json()["points"][0];
    println!("{}", point["note"]);
    let limits = point["unreachable"]["without_limits"].as_array().expect("met without limits").clone();
    let rail = limits.iter().find(|limit| limit["joint"] == "rail").expect("the rail");
    assert!(rail["end"] == "high" && rail["limit"] == 4.0 && rail["beyond"].as_f64() > Some(0.1), "{rail}");
    assert!(
        ended.stderr.contains("it could be reached with rail")
            && ended.stderr.contains("beyond its upper limit of 4000.000 mm"),
        "{}",
        ended.stderr
    );

    // A robot that is too slow; and points that lie too far apart, with a hole in the path.
    sandbox.write("panel.toml", panel(&estimate, [0.4, 0.1], 0.1, 0.02, 0.3));
    let slow = ["--targets", "panel.toml", "--speed-limits", "0.1,0.1,0.1,0.1,0.1,0.1,0.1"];
    let ended = compensate(&sandbox, &slow);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(
        ended.stderr.contains("steps are too fast; worst to point")
            && ended.stderr.contains("above its limit of 0.100"),
        "{}",
        ended.stderr
    );
    let ended = compensate(&sandbox, &["--targets", "panel.toml", "--longest-step", "0.0001", "--json"]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(ended.stderr.contains("reached only with a jump,"), "{}", ended.stderr);
    assert!(
        ended.json()["points"].as_array().expect("points").iter().any(|point| point["status"] == "jumped")
    );
    let mut lines: Vec<String> = points(&estimate, "", 4).lines().map(str::to_owned).collect();
    lines[2] = "hole,30000,0,0".to_owned();
    sandbox.write("holed.csv", lines.join("\n") + "\n");
    let ended = compensate(
        &sandbox,
        &["--targets", "holed.csv", "--speed-mm-per-s", "10", "--longest-step", "3", "--json"],
    );
    let json = ended.json();
    assert_eq!((&json["kind"], &json["points"][1]["status"]), (&"path".into(), &"unreachable".into()));
    assert!(json["points"][1]["unreachable"]["missed_m"][0].as_f64().is_some_and(|x| x > 1.0), "{json}");
    assert!(json["points"][2]["command"].is_array());
}

/// Payload, temperature, tool, axis: what is stated changes what is predicted as it does there.
#[test]
fn what_the_flange_carries_and_where_the_tool_is_can_be_stated() {
    let (sandbox, estimate) = bench(&PAINTER, None);
    let robot = &estimate.estimate.robot;
    sandbox.write("points.csv", points(&estimate, "", 3));
    let load = Payload::of_mass("12 kg", 12.0, Vector3::new(0.0, 0.01, 0.12));
    sandbox.write(
        "session.toml",
        "schema = \"calibrig.session/1\"\n[[payload]]\nname = \"12 kg\"\nset = \"identification\"\nmass_kg = 12\nx_mm = 0\ny_mm = 10\nz_mm = 120\n",
    );
    let run = |rest: &[&str]| {
        let ended = compensate(&sandbox, &[&["--targets", "points.csv", "--out", "out"], rest].concat());
        assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
        rows(&sandbox.read("out/compensated.csv"))
    };
    let plain = run(&[]);
    let carried = run(&["--payload-kg", "12", "--payload-centre-mm", "0,10,120"]);
    assert_eq!(carried, run(&["--session", "session.toml"]));
    assert_eq!(carried, run(&["--session", "session.toml", "--payload", "12 kg"]));
    assert_ne!(carried, plain);
    let mut predictor = Predictor::new(robot).expect("a robot");
    for row in &carried {
        let at = command(row, &robot.nominal, "q");
        let mut pose = PoseQuery::at(&at);
        pose.payload = Some(&load);
        let there = predictor.in_base(pose).expect("a pose");
        assert!((there - place(row, ["x_mm", "y_mm", "z_mm"])).norm() < 1e-6, "{row:?}");
    }
    // Another tool on the same flange.
    let stated =
        run(&["--tool-mm", "50,-20,300", "--tool-axis", "0,1,0", "--criterion", "limits,motion=0.5"]);
    let mut beside = robot.clone();
    beside.targets[0] = Vector3::new(0.05, -0.02, 0.3);
    let mut predictor = Predictor::new(&beside).expect("a robot");
    for row in stated.iter().filter(|row| row["status"] == "met") {
        let at = command(row, &robot.nominal, "q");
        let there = predictor.in_base(&at).expect("a pose");
        assert!((there - place(row, ["x_mm", "y_mm", "z_mm"])).norm() < 1e-6, "{row:?}");
    }
    assert!(stated.iter().any(|row| row["status"] == "met"));
    let name = estimate.targets[0].clone();
    assert_eq!(plain, run(&["--tool", &name]));
}

#[test]
fn what_cannot_be_corrected_is_refused_before_anything_is_written() {
    let (sandbox, estimate) = bench(&UR5, None);
    let sound = points(&estimate, AXIS, 3);
    sandbox.write("points.csv", &sound);
    let ask = |targets: &'static str, rest: &[&'static str]| {
        [&["compensate", "--estimate", "estimate.json", "--targets", targets, "--out", "out"], rest].concat()
    };
    let refused = |arguments: &[&str], place: &str, message: &str, help: &str| {
        assert_refused(&sandbox, arguments, place, message, help);
    };
    // Tables.
    let lines: Vec<&str> = sound.lines().collect();
    let table = |name: &str, change: &dyn Fn(&mut Vec<String>)| {
        let mut lines: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
        change(&mut lines);
        sandbox.write(name, lines.join("\n") + "\n");
    };
    table("nan.csv", &|lines| lines[2] = "P1,1,NaN,3,0,0,1".to_owned());
    refused(&ask("nan.csv", &[]), "nan.csv:3", "column y_mm is NaN", "a finite number");
    table("twice.csv", &|lines| lines[2] = lines[1].clone());
    refused(
        &ask("twice.csv", &["--speed-mm-per-s", "100"]),
        "twice.csv:3",
        "point 2 of the path is at the same place as point 1: leave one of them out",
        "consecutive places that differ",
    );
    table("short.csv", &|lines| lines[3] = "P2,1,2".to_owned());
    refused(&ask("short.csv", &[]), "short.csv:4", "the row has 3 of 7 columns", "7 values");
    table("unit.csv", &|lines| lines[0] = lines[0].replace("x_mm", "x_deg"));
    refused(&ask("unit.csv", &[]), "unit.csv:1", "column x_deg is in deg", "x_mm or x_m");
    sandbox.write("empty.csv", "");
    refused(&ask("empty.csv", &[]), "empty.csv:1", "the file is empty", "names of the columns");
    sandbox.write("header.csv", "x_mm,y_mm,z_mm\n");
    refused(&ask("header.csv", &[]), "header.csv:1", "the file has no points", "one row per point");
    sandbox.write("back.csv", "x_mm,y_mm,z_mm,time_s\n1,2,3,1\n2,2,3,0.5\n");
    refused(&ask("back.csv", &[]), "back.csv:3", "point 2 of the path is at 0.5 s", "times that increase");
    refused(
        &ask("back.csv", &["--speed-mm-per-s", "1"]),
        "back.csv:2",
        "times (time_s), and",
        "no --speed-mm-per-s",
    );
    let ended = sandbox.run(ask("missing.csv", &[]));
    assert!(ended.code == Some(1) && ended.stderr.contains("missing.csv"), "{ended:?}");
    // Rasters and grids.
    let raster = panel(&estimate, [0.1, 0.1], 0.02, 0.01, 0.1);
    sandbox.write("still.toml", raster.replace("speed_mm_per_s = 100\n", ""));
    refused(&ask("still.toml", &[]), "still.toml:2", "the raster has no speed", "speed_mm_per_s");
    sandbox.write("crossed.toml", raster.replace("corners_mm = [[", "corners_mm = [[9999, 0, 0], ["));
    let ended = sandbox.run(ask("crossed.toml", &[]));
    assert!(
        ended.code == Some(1) && ended.stderr.contains("crossed.toml:3: raster.corners_mm has 5 corners"),
        "{ended:?}"
    );
    sandbox.write("line.toml", "schema = \"calibrig.goals/1\"\n[raster]\ncorners_mm = [[0,0,0],[1,0,0],[2,0,0],[0,1,0]]\npitch_mm = 1\nspacing_mm = 1\nspeed_mm_per_s = 1\n");
    refused(
        &ask("line.toml", &[]),
        "line.toml:3",
        "the corners do not form a panel",
        "in order around the panel",
    );
    sandbox.write("flat.toml", "schema = \"calibrig.goals/1\"\n[grid]\nlow_mm = [0, 0, 0]\nhigh_mm = [100, 100, 0]\npoints = [2, 2, 2]\n");
    refused(
        &["compensate", "--estimate", "estimate.json", "--grid", "flat.toml"],
        "flat.toml:3",
        "along z",
        "high_mm above low_mm",
    );
    refused(
        &["compensate", "--estimate", "estimate.json", "--grid", "still.toml"],
        "still.toml:1",
        "the file has no [grid]",
        "low_mm",
    );
}

#[test]
fn estimates_and_flags_that_are_not_of_the_robot_are_refused() {
    let (sandbox, estimate) = bench(&UR5, None);
    sandbox.write("points.csv", points(&estimate, AXIS, 3));
    let ask = |targets: &'static str, rest: &[&'static str]| {
        [&["compensate", "--estimate", "estimate.json", "--targets", targets, "--out", "out"], rest].concat()
    };
    let refused = |arguments: &[&str], place: &str, message: &str, help: &str| {
        assert_refused(&sandbox, arguments, place, message, help);
    };
    // Estimates and robots.
    let other = "models/spray_painter/robot.toml";
    refused(
        &ask("points.csv", &["--model", other]),
        other,
        "the estimate is of the model",
        "the robot file that the estimate was made with",
    );
    let text = sandbox.read("estimate.json");
    sandbox.write("half.json", &text[..text.len() / 2]);
    let of = |estimate: &'static str| {
        ["compensate", "--estimate", estimate, "--targets", "points.csv", "--out", "out"]
    };
    refused(&of("half.json"), "half.json:", "EOF", "a whole file");
    refused(&of("points.csv"), "points.csv:1", "expected", "");
    let ended = sandbox.run(of("missing.json"));
    assert!(ended.code == Some(1) && ended.stderr.contains("missing.json"), "{ended:?}");
    refused(
        &ask("points.csv", &["--mode", "extended"]),
        "estimate.json",
        "no estimate of mode extended",
        "its own mode",
    );
    // Flags.
    refused(
        &ask("points.csv", &["--start", "1,2,3"]),
        "--start",
        "has 3 numbers, but the robot has 6 actuators",
        "a command of",
    );
    refused(
        &ask("points.csv", &["--approach", "1,1"]),
        "--approach",
        "has 2 numbers",
        "the sign of the last motion of",
    );
    refused(
        &ask("points.csv", &["--speed-limits", "1,1,1,1,1,0"]),
        "--speed-limits",
        "holds 0",
        "above zero",
    );
    refused(
        &ask("points.csv", &["--tool", "nose"]),
        "--tool",
        "\"nose\", which is not a target of the estimate",
        &estimate.targets[0],
    );
    refused(&ask("points.csv", &["--tool-mm", "1,2"]), "--tool-mm", "has 2 numbers", "three numbers");
    refused(&ask("points.csv", &["--tool-axis", "0,0,0"]), "--tool-axis", "cannot be", "not all zero");
    for (flag, value) in [
        ("--criterion", "speed"),
        ("--trust-mm", "-1"),
        ("--longest-step", "0"),
        ("--start", "a,b"),
        ("--tolerance-um", "0"),
    ] {
        let ended = sandbox.run(ask("points.csv", &[flag, value]));
        assert!(ended.code == Some(2) && ended.stderr.contains(value), "{ended:?}");
    }
    let ended = sandbox.run(["compensate", "--estimate", "estimate.json"]);
    assert!(ended.code == Some(2) && ended.stderr.contains("--targets"), "{ended:?}");
    sandbox.write("taken", "a file");
    refused(
        &["compensate", "--estimate", "estimate.json", "--targets", "points.csv", "--out", "taken"],
        "cannot write to the folder taken",
        "no folder",
        "a folder",
    );
}

/// A robot without masses cannot be asked for the least deflection.
#[test]
fn a_criterion_that_the_robot_cannot_answer_is_refused() {
    let mut rigid = EstimateFile::of(&PAINTER, Some(Mode::OnlyCalibration)).expect("an estimate");
    let robot = &mut rigid.estimate.robot;
    (robot.nominal.statics, robot.model.statics) = (None, None);
    rigid.robot.model_sha256 = model_sha256(&robot.nominal);
    let sandbox = Sandbox::new();
    sandbox.write("estimate.json", rigid.text().expect("JSON"));
    let estimate = EstimateFile::read(&sandbox.path("estimate.json")).expect("as written");
    sandbox.write("points.csv", points(&estimate, "", 2));
    let arguments =
        ["compensate", "--estimate", "estimate.json", "--targets", "points.csv", "--criterion", "deflection"];
    assert_refused(&sandbox, &arguments, "points.csv", "no masses and stiffnesses", "--criterion limits");
}

/// Ctrl-C: what was corrected is kept, and said to be a part.
#[cfg(unix)]
#[test]
fn what_was_corrected_before_an_interruption_is_kept() {
    use std::process::{Command, Stdio};
    use std::time::Duration;
    let (sandbox, estimate) = bench(&PAINTER, None);
    // Several hundred thousand points: minutes.
    sandbox.write("panel.toml", panel(&estimate, [1.0, 0.8], 0.01, 0.2e-3, 0.02));
    let mut command = sandbox.command([
        "compensate",
        "--estimate",
        "estimate.json",
        "--targets",
        "panel.toml",
        "--out",
        "out",
    ]);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the binary starts");
    std::thread::sleep(Duration::from_secs(4));
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().expect("kill");
    assert!(sent.success());
    let ended = Ended::from(child.wait_with_output().expect("it ends"));
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(
        ended.stderr.contains("doubtful: interrupted after ")
            && ended.stderr.contains("the rest is not corrected"),
        "{}",
        ended.stderr
    );
    let found = rows(&sandbox.read("out/compensated.csv"));
    println!("{} points were corrected", found.len());
    assert!(found.len() > 10 && found.len() < 400_000);
    assert!(sandbox.read("out/compensation.html").contains("interrupted after"));
}

#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_written_to_loses_no_result() {
    use std::os::unix::fs::PermissionsExt;
    let (sandbox, estimate) = bench(&UR5, None);
    sandbox.write("points.csv", points(&estimate, "", 2));
    sandbox.make_folder("closed");
    let folder = sandbox.path("closed");
    std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(0o555)).expect("ours");
    // Root may write anywhere.
    if std::fs::write(folder.join("probe"), "").is_ok() {
        return;
    }
    let ended = compensate(&sandbox, &["--targets", "points.csv", "--out", "closed"]);
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(
        ended.stdout.contains("2 of 2 points are met") && ended.stderr.contains("cannot write closed"),
        "{ended:?}"
    );
}
