//! What every command keeps to: exit codes, streams, JSON, colours, and the files that are left.

use std::fs;
use std::io::Read;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::a_user_makes_a_mistake::with_measurements;
use crate::sandbox::{Ended, ROBOT, SCENARIO, Sandbox, assert_refused};

const COMMANDS: [&str; 18] = [
    "run",
    "check",
    "choose",
    "columns",
    "diagnose",
    "identify",
    "identifiability",
    "iso9283",
    "merge",
    "missing",
    "montecarlo",
    "model",
    "plan",
    "replay",
    "inspect",
    "recover",
    "report",
    "scenario",
];
#[cfg(feature = "rerun")]
const FILES: &[&str] = &["report.html", "report.json", "residuals.csv", "recording.mcap", "recording.rrd"];
#[cfg(not(feature = "rerun"))]
const FILES: &[&str] = &["report.html", "report.json", "residuals.csv", "recording.mcap"];

/// Every command with arguments that succeed, in a sandbox that has the files.
fn sound_commands() -> (Sandbox, Vec<(&'static str, Vec<&'static str>)>) {
    let sandbox = with_measurements("set.csv");
    let ended = sandbox.run(["run", SCENARIO, "--out", "first"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    sandbox.write("scara.urdf", include_str!("../fixtures/urdf/10_scara.urdf"));
    let commands = vec![
        ("calibrig.model/1", vec!["model", "from-urdf", "scara.urdf", "--out", "made", "--force"]),
        ("calibrig.twin/1", vec!["scenario", "new", "--model", ROBOT, "--out", "twin.toml", "--force"]),
        ("calibrig.identifiability/1", vec!["identifiability", "--urdf", "scara.urdf"]),
        ("calibrig.report/1", vec!["run", SCENARIO, "--out", "out"]),
        ("calibrig.check/1", vec!["check", SCENARIO]),
        ("calibrig.choice/1", vec!["choose", SCENARIO]),
        ("calibrig.identifiability/1", vec!["identifiability", SCENARIO]),
        ("calibrig.identifiability/1", vec!["identifiability", "--model", ROBOT]),
        ("calibrig.report/1", vec!["identify", "--model", ROBOT, "--measurements", "set.csv"]),
        (
            "calibrig.report/1",
            vec!["identify", "--model", ROBOT, "--measurements", "set.csv", "--verify", "set.csv"],
        ),
        ("calibrig.diagnosis/1", vec!["diagnose", "--model", ROBOT, "--measurements", "set.csv"]),
        ("calibrig.iso9283/1", vec!["iso9283", SCENARIO, "--cycles", "3"]),
        ("calibrig.plan/1", vec!["plan", SCENARIO, "--poses", "12", "--candidates", "100"]),
        ("calibrig.report/1", vec!["replay", "first/recording.mcap"]),
        ("calibrig.report/1", vec!["report", "first/recording.mcap", "--out", "again"]),
        ("calibrig.inspect/1", vec!["inspect", "first/recording.mcap"]),
    ];
    (sandbox, commands)
}

#[track_caller]
fn assert_usage(ended: &Ended, message: &str) {
    assert_eq!((ended.code, ended.stdout.as_str()), (Some(2), ""), "{ended:?}");
    assert!(ended.stderr.contains(message), "{message:?} is not in {}", ended.stderr);
}

#[test]
fn wrong_usage_ends_with_2_and_says_what_was_expected() {
    let sandbox = Sandbox::new();
    let measured = ["identify", "--model", ROBOT, "--measurements", "set.csv"];
    let identify = |more: &[&'static str]| [&measured[..], more].concat();
    let tolerance = "expected a number from 0.000001 to 1000000, or 0";
    let seed = "expected a whole number from 0 to 18446744073709551615";
    for (arguments, message) in [
        (vec![], "Usage: calibrig <COMMAND>"),
        (vec!["calibrate"], "unrecognized subcommand 'calibrate'"),
        (vec!["run"], "<SCENARIO>"),
        (vec!["check"], "<SCENARIO>"),
        (vec!["replay"], "<RECORDING>"),
        (vec!["identify", "--model", ROBOT], "--measurements <[TARGET=]FILE>"),
        (vec!["diagnose", "--model", ROBOT], "--measurements <[TARGET=]FILE>"),
        (vec!["identify", "--measurements", "set.csv"], "--model <ROBOT.toml>"),
        (vec!["identifiability"], "<SCENARIO|--model <ROBOT.toml>|--urdf <FILE>>"),
        (vec!["choose", "--model", ROBOT], "--measurements <[TARGET=]FILE>"),
        (vec!["choose", "--urdf", "a.urdf"], "--measurements <[TARGET=]FILE>"),
        (identify(&["--urdf", "a.urdf"]), "cannot be used with"),
        (identify(&["--tip", "tool0"]), "--tip: expected --urdf with it"),
        (vec!["model", "from-dh", "t.csv", "--out", "o"], "--convention <CONVENTION>"),
        (vec!["model", "from-urdf", "a.urdf"], "--out <DIR>"),
        (vec!["scenario", "new", "--model", ROBOT], "--out <FILE>"),
        (vec!["scenario", "new", "--out", "o.toml"], "--model <ROBOT.toml>"),
        (
            vec!["scenario", "new", "--model", ROBOT, "--out", "o.toml", "--tracker", "at402"],
            "expected one of: at500",
        ),
        (
            vec!["scenario", "new", "--model", ROBOT, "--out", "o.toml", "--floor-mm", "low"],
            "expected a number of mm",
        ),
        (
            vec!["scenario", "new", "--model", ROBOT, "--out", "o.toml", "--class", "tiny"],
            "invalid value 'tiny'",
        ),
        (
            vec!["model", "from-urdf", "a.urdf", "--out", "o", "--target-mm", "1,2"],
            "expected three numbers of mm separated by commas,",
        ),
        (vec!["choose", SCENARIO, "--folds", "1"], "1 is not in 2.."),
        (vec!["identifiability", SCENARIO, "--model", ROBOT], "cannot be used with"),
        (vec!["run", SCENARIO, "--sed", "3"], "a similar argument exists: '--seed'"),
        (vec!["run", SCENARIO, "--seed", "-3"], seed),
        (vec!["run", SCENARIO, "--seed", "1.5"], seed),
        (vec!["run", SCENARIO, "--seed", "18446744073709551616"], seed),
        (vec!["run", SCENARIO, "--out"], "a value is required for '--out <DIR>'"),
        (vec!["run", SCENARIO, "--seed", "1", "--seed", "2"], "cannot be used multiple times"),
        (vec!["run", SCENARIO, SCENARIO], "unexpected argument"),
        (identify(&["--parameters", "some"]), "expected complete, neighbour_axis_rules, or names of link"),
        (identify(&["--tolerance-mm", "-1"]), tolerance),
        (identify(&["--tolerance-mm", "ten"]), tolerance),
        (identify(&["--tolerance-mm", "nan"]), tolerance),
        (identify(&["--tolerance-mrad", "1e-300"]), tolerance),
        (identify(&["--tolerance-mrad", "1e300"]), tolerance),
        (identify(&["--tolerance-mrad", "0"]), "expected 0 for both, or both above zero"),
    ] {
        let before = sandbox.content();
        assert_usage(&sandbox.run(&arguments), message);
        assert!(sandbox.content() == before, "{arguments:?}");
    }
}

/// The commands of a help text's examples, as words.
fn examples(help: &str) -> Vec<Vec<&str>> {
    let (_, examples) = help.split_once("Examples:").expect("examples");
    let commands = examples.lines().filter_map(|line| line.strip_prefix("  calibrig "));
    // Two blanks part a command from what it is for.
    commands.map(|line| line.split("  ").next().unwrap_or(line).split(' ').collect()).collect()
}

#[test]
fn help_shows_examples_that_are_true() {
    let (sandbox, _) = sound_commands();
    // As shipped: without its effects, the terms for them do harm and are doubted.
    sandbox.write(SCENARIO, std::fs::read_to_string(SCENARIO).expect("the shipped scenario"));
    let help = sandbox.run(["--help"]);
    assert_eq!((help.code, help.stderr.as_str()), (Some(0), ""));
    for command in COMMANDS {
        assert!(help.stdout.contains(&format!("\n  {command} ")), "{}", help.stdout);
        let helps = ["--help", "-h"].map(|flag| sandbox.run([command, flag]));
        for help in &helps {
            assert_eq!((help.code, help.stderr.as_str()), (Some(0), ""), "{command}");
        }
        let shown = examples(&helps[0].stdout);
        assert!(shown.len() >= 2, "{command}: {}", helps[0].stdout);
        assert_eq!(shown, examples(&helps[1].stdout), "{command}");
        for mut example in shown {
            assert_eq!(example[0], command);
            // The shape of the command is what counts: a few trials show it as well as thousands.
            if let Some(flag) = example.iter().position(|word| *word == "--trials") {
                example[flag + 1] = "2";
            }
            // The files are those of the repository, or made up; the arguments must be accepted.
            let ended = sandbox.run(&example);
            if example.iter().any(|word| word.starts_with("--live")) {
                // Nobody has a viewer open here; a build without Rerun takes no such flag.
                let expected = if cfg!(feature = "rerun") { 1 } else { 2 };
                assert_eq!(ended.code, Some(expected), "{example:?}: {}", ended.stderr);
                continue;
            }
            assert_ne!(ended.code, Some(2), "{example:?}: {}", ended.stderr);
            if example.iter().any(|word| [SCENARIO, "models/ur5/robot.toml"].contains(word))
                && !["identify", "choose", "diagnose", "montecarlo"].contains(&command)
            {
                assert_eq!(ended.code, Some(0), "{example:?}: {}", ended.stderr);
            }
        }
    }
    let version = sandbox.run(["--version"]);
    assert_eq!(version.stdout, format!("calibrig {}\n", env!("CARGO_PKG_VERSION")));
}

#[test]
fn every_command_prints_json_and_nothing_else() {
    let (sandbox, commands) = sound_commands();
    for (schema, mut arguments) in commands {
        let text = sandbox.run(&arguments);
        assert_eq!(text.code, Some(0), "{arguments:?}: {text:?}");
        assert!(!text.stdout.is_empty() && !text.stdout.starts_with('{'), "{arguments:?}: {text:?}");
        arguments.push("--json");
        let ended = sandbox.run(&arguments);
        assert_eq!(ended.code, Some(0), "{arguments:?}: {ended:?}");
        assert_eq!(ended.json()["schema"], schema, "{arguments:?}");
        assert!(ended.stdout.ends_with("}\n"));
    }
    let written: serde_json::Value = serde_json::from_str(&sandbox.read("out/report.json")).expect("JSON");
    assert_eq!(written, sandbox.run(["run", SCENARIO, "--out", "out", "--json"]).json());
    let check = sandbox.run(["check", SCENARIO, "--json"]).json();
    assert_eq!((&check["name"], &check["identification_poses"]), (&"paper".into(), &60.into()));
    let rank = &sandbox.run(["identifiability", SCENARIO, "--json"]).json()["complete_set"];
    assert_eq!((&rank["rank"], &rank["structural_rank"]), (&26.into(), &26.into()));
}

#[test]
fn nothing_is_coloured_that_is_no_terminal() {
    let (sandbox, commands) = sound_commands();
    for (_, arguments) in
        commands.iter().chain([&("", vec!["check", "none.toml"]), &("", vec!["run", "--none"])])
    {
        let ended = sandbox.run(arguments);
        assert!(!ended.stdout.contains('\x1b') && !ended.stderr.contains('\x1b'), "{arguments:?}: {ended:?}");
    }
}

/// `script` of util-linux gives the process a terminal.
#[cfg(target_os = "linux")]
#[test]
fn no_color_is_respected_on_a_terminal() {
    let sandbox = Sandbox::new();
    sandbox.write("bad.toml", "seed = 1\n");
    let on_terminal = |arguments: &str, no_color: Option<&str>| {
        let mut command = Command::new("script");
        let line = format!("{} {arguments}", env!("CARGO_BIN_EXE_calibrig"));
        command.current_dir(sandbox.path("")).args(["-qec", &line, "/dev/null"]).stdin(Stdio::null());
        command.env("TERM", "xterm-256color").env_remove("NO_COLOR");
        if let Some(value) = no_color {
            command.env("NO_COLOR", value);
        }
        command.output().map(|output| String::from_utf8_lossy(&output.stdout).into_owned())
    };
    for arguments in ["check bad.toml", "run scenarios/paper.toml --out out", "run --none", "--help"] {
        let Ok(coloured) = on_terminal(arguments, None) else {
            eprintln!("SKIPPED: there is no `script` command, colours are not looked at");
            return;
        };
        // A progress bar moves the cursor as well: that is no colour.
        let is_colour = |sequence: &str| {
            sequence.split_once('m').is_some_and(|(codes, _)| {
                !codes.trim_start_matches(['0', ';']).is_empty()
                    && codes.chars().all(|c| c.is_ascii_digit() || c == ';')
            })
        };
        let is_coloured = |text: &str| text.split("\x1b[").skip(1).any(is_colour);
        assert!(is_coloured(&coloured), "{arguments}: {coloured:?}");
        let plain = on_terminal(arguments, Some("1")).expect("it ran a moment ago");
        assert!(!plain.is_empty() && !is_coloured(&plain), "{arguments}: {plain:?}");
        // An empty value does not count, by the convention.
        assert!(is_coloured(&on_terminal(arguments, Some("")).expect("it ran")), "{arguments}");
    }
}

#[test]
fn a_reader_that_goes_away_is_no_failure() {
    let (sandbox, mut commands) = sound_commands();
    commands.push(("", vec!["--help"]));
    for (_, arguments) in commands {
        let mut child = sandbox
            .command(&arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the binary starts");
        drop(child.stdout.take());
        let mut stderr = String::new();
        child.stderr.take().expect("piped").read_to_string(&mut stderr).expect("UTF-8");
        let code = child.wait().expect("ended").code();
        assert_eq!(code, Some(0), "{arguments:?}: {stderr}");
        assert!(!stderr.contains("panicked") && !stderr.contains("error"), "{arguments:?}: {stderr}");
    }
    // And the files are there.
    for file in FILES {
        assert!(sandbox.path("out").join(file).is_file(), "{file}");
    }
    // Nobody reads the complaint either: the exit code still tells.
    let mut child = sandbox.command(["check", "none.toml"]).stderr(Stdio::piped()).spawn().expect("started");
    drop(child.stderr.take());
    assert_eq!(child.wait().expect("ended").code(), Some(1));
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_behind_stdout_is_a_failure() {
    let sandbox = Sandbox::new();
    let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a device of Linux");
    let output = sandbox.command(["check", SCENARIO]).stdout(full).output().expect("the binary starts");
    let ended = Ended::from(output);
    assert_eq!(ended.code, Some(1), "{ended:?}");
    assert!(
        ended.stderr.starts_with("error: cannot write standard output: No space left"),
        "{}",
        ended.stderr
    );
}

/// Runs `modes` (key and title) with and without `--json`: exit code 3, and every one of `named` on stderr.
#[track_caller]
fn assert_doubtful(sandbox: &Sandbox, modes: &[(&str, &str)], named: &[&str]) -> serde_json::Value {
    let keys: Vec<_> = modes.iter().map(|(key, _)| key).collect();
    sandbox.set("[identification]", "modes", &format!("{keys:?}"));
    let tables = sandbox.run(["run", SCENARIO, "--out", "out"]);
    let ended = sandbox.run(["run", SCENARIO, "--out", "out", "--json"]);
    for ended in [&tables, &ended] {
        assert_eq!(ended.code, Some(3), "{ended:?}");
        let doubts: Vec<_> = ended.stderr.lines().filter(|line| line.starts_with("doubtful: ")).collect();
        assert_eq!(doubts.len(), modes.len(), "one a mode: {}", ended.stderr);
        for (doubt, (_, title)) in doubts.iter().zip(modes) {
            assert!(doubt.starts_with(&format!("doubtful: {title}: ")), "{doubt}");
            for name in named {
                assert!(doubt.contains(name), "{name} is not named: {doubt}");
            }
        }
    }
    for file in FILES {
        assert!(sandbox.path("out").join(file).is_file(), "a doubtful result is a result: {file}");
    }
    ended.json()
}

#[test]
fn redundant_parameters_end_with_3_and_are_named() {
    let sandbox = Sandbox::new();
    sandbox.set("[identification]", "parameters", "[\"delta_d3\", \"delta_d4\", \"delta_a2\"]");
    // Where gravity tilts the axes, the two are no longer the same to the last digits.
    let modes = [("only_calibration", "only calibration")];
    let report = assert_doubtful(&sandbox, &modes, &["rank 11 of 12 parameters", "delta_d3", "delta_d4"]);
    let estimate = &report["estimates"]["only_calibration"];
    assert_eq!((&estimate["rank"], &estimate["parameter_count"]), (&11.into(), &12.into()));
    let sigmas = report["parameters"].as_array().expect("parameters");
    assert!(
        !sigmas.is_empty() && sigmas.iter().all(|p| p["sigma"].is_null()),
        "no covariance from a singular system"
    );
    let replayed = sandbox.run(["replay", "out/recording.mcap"]);
    assert_eq!(replayed.code, Some(3), "{replayed:?}");
    assert!(
        replayed.stderr.contains("delta_d4") && !replayed.stderr.contains("replay differs"),
        "{}",
        replayed.stderr
    );
}

#[test]
fn an_unconverged_fit_ends_with_3_and_says_what_moves_and_what_to_do() {
    let sandbox = Sandbox::new();
    sandbox.set("[identification]", "max_iterations", "1");
    let modes = [
        ("only_calibration", "only calibration"),
        ("with_gravity", "calibration considering gravity"),
        ("elasto_geometric", "geometry and stiffness"),
    ];
    let report = assert_doubtful(
        &sandbox,
        &modes,
        &[
            "not converged: iteration_limit",
            "--max-iterations",
            "weak directions",
            "the tool's offset",
            "The last step moved",
        ],
    );
    assert_eq!(report["estimates"]["with_gravity"]["termination"], "iteration_limit");
    assert_eq!(report["estimates"]["with_gravity"]["iterations"], 1);
}

#[test]
fn a_rank_that_these_poses_lack_ends_with_3() {
    let sandbox = Sandbox::new();
    sandbox.set("[poses]", "identification", "5");
    let ended = sandbox.run(["identifiability", SCENARIO]);
    assert_eq!(ended.code, Some(3), "{ended:?}");
    assert!(ended.stdout.contains("structural rank 26, rank 15 at these poses"), "{}", ended.stdout);
    assert!(ended.stdout.contains("Not determined by these poses"), "{}", ended.stdout);
}

#[test]
fn runs_without_out_go_side_by_side() {
    let sandbox = Sandbox::new();
    let first = sandbox.run(["run", SCENARIO]);
    assert_eq!(first.code, Some(0), "{first:?}");
    assert!(first.stderr.contains("to runs/paper\n"), "{}", first.stderr);
    let before = sandbox.content();
    let second = sandbox.run(["run", SCENARIO, "--seed", "2"]);
    assert!(second.stderr.contains("to runs/paper-2\n"), "{}", second.stderr);
    let after = sandbox.content();
    assert!(before.iter().all(|(path, bytes)| after.get(path) == Some(bytes)), "an older run was touched");
    for file in FILES {
        assert!(sandbox.path("runs/paper-2").join(file).is_file(), "{file}");
    }
    assert_ne!(sandbox.read("runs/paper/report.json"), sandbox.read("runs/paper-2/report.json"));
    // A name may hold what no folder's name should.
    sandbox.set("", "name", "\"../../a b\"");
    let third = sandbox.run(["run", SCENARIO]);
    assert!(third.stderr.contains("to runs/______a_b\n"), "{}", third.stderr);
}

#[test]
fn commands_that_only_look_leave_nothing() {
    let (sandbox, commands) = sound_commands();
    let before = sandbox.content();
    let looks = |arguments: &[&str]| !["run", "report", "model", "scenario"].contains(&arguments[0]);
    for (_, arguments) in commands.iter().filter(|(_, arguments)| looks(arguments.as_slice())) {
        assert_eq!(sandbox.run(arguments).code, Some(0));
    }
    assert!(sandbox.content() == before);
}

#[test]
fn out_is_written_over_by_a_run_and_left_alone_by_a_failure() {
    let sandbox = Sandbox::new();
    sandbox.make_folder("out");
    for file in FILES.iter().chain(&["notes.txt"]) {
        sandbox.write(&format!("out/{file}"), "old");
    }
    for (marker, key, value) in
        [("[poses]", "identification", "2"), ("joint = \"shoulder\"", "stiffness_factor", "1e-9")]
    {
        let broken = Sandbox::new();
        broken.set(marker, key, value);
        sandbox.write("scenarios/broken.toml", broken.read(SCENARIO));
        let before = sandbox.content();
        let ended = sandbox.run(["run", "scenarios/broken.toml", "--out", "out"]);
        assert_eq!((ended.code, ended.stdout.as_str()), (Some(1), ""), "{ended:?}");
        assert!(ended.stderr.starts_with("error: scenarios/broken.toml:"), "{}", ended.stderr);
        assert!(sandbox.content() == before, "{key}");
    }
    let ended = sandbox.run(["run", SCENARIO, "--out", "out"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(FILES.iter().all(|file| fs::read(sandbox.path("out").join(file)).expect("a file") != b"old"));
    assert_eq!(sandbox.read("out/notes.txt"), "old");
    let names = fs::read_dir(sandbox.path("out")).expect("a folder").count();
    assert_eq!(names, FILES.len() + 1, "nothing else is left");
}

#[test]
fn a_place_that_cannot_be_written_to_is_found_before_the_run() {
    let sandbox = with_measurements("set.csv");
    sandbox.write("file", "");
    sandbox.make_folder("html/report.html");
    sandbox.make_folder("json/report.json");
    sandbox.make_folder("recorded/recording.mcap");
    let identify = ["identify", "--model", ROBOT, "--measurements", "set.csv", "--out"];
    let folder = "a folder, or the name of a new one";
    for command in [&["run", SCENARIO, "--out"][..], &identify] {
        let to = |folder: &'static str| [command, &[folder]].concat();
        assert_refused(
            &sandbox,
            &to("file"),
            "cannot write to the folder file: ",
            "file is no folder",
            folder,
        );
        assert_refused(
            &sandbox,
            &to("file/out/a"),
            "cannot write to the folder file/out/a: ",
            "file is no folder",
            folder,
        );
        for (out, taken) in [("html", "html/report.html"), ("json", "json/report.json")] {
            let place = format!("cannot write to the folder {out}: {taken} is a folder");
            assert_refused(&sandbox, &to(out), &place, "", "the name of a folder;");
        }
    }
    let out = ["run", SCENARIO, "--out", "recorded"];
    assert_refused(
        &sandbox,
        &out,
        "cannot write to the folder recorded: ",
        "recording.mcap is a folder",
        "the name of a folder;",
    );
    // `identify` writes no recording.
    assert_eq!(sandbox.run([&identify[..], &["recorded"]].concat()).code, Some(0));
    sandbox.write("runs", "");
    assert_refused(
        &sandbox,
        &["run", SCENARIO],
        "cannot write to the folder runs: ",
        "runs is no folder",
        folder,
    );
}

/// Every final name holds the old file or the whole new one.
#[cfg(unix)]
fn assert_whole(sandbox: &Sandbox, new: &Sandbox, when: &str) {
    for file in FILES {
        let found = fs::read(sandbox.path("out").join(file)).expect("the old file at least");
        let whole = fs::read(new.path("out").join(file)).expect("the new file");
        // Rerun's recordings hold times and random numbers. Twelve bytes end them: a mark and four more.
        let ends = |file: &[u8]| file.len().checked_sub(12).map(|at| file[at..at + 8].to_vec());
        let is_new = found == whole
            || (*file == "recording.rrd" && found.starts_with(b"RRF2") && ends(&found) == ends(&whole));
        assert!(found == b"old" || is_new, "{file} is neither old nor whole {when}: {} bytes", found.len());
    }
}

/// The signal of Ctrl-C; SIGTERM where SIGINT is ignored, as it is in a shell's background job and in all that it starts.
#[cfg(unix)]
fn interrupt() -> &'static str {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    if ignored & 0b10 == 0 { "-INT" } else { "-TERM" }
}

#[cfg(unix)]
#[test]
fn an_interrupt_leaves_no_half_file() {
    let reference = Sandbox::new();
    assert_eq!(reference.run(["run", SCENARIO, "--out", "out"]).code, Some(0));
    let interrupted = |sandbox: &Sandbox, after: Duration| {
        sandbox.make_folder("out");
        for file in FILES {
            sandbox.write(&format!("out/{file}"), "old");
        }
        let mut run = sandbox.command(["run", SCENARIO, "--out", "out"]);
        let mut child = run.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the binary starts");
        std::thread::sleep(after);
        let killed = Command::new("kill")
            .args([interrupt(), &child.id().to_string()])
            .status()
            .expect("a `kill` command");
        let code = child.wait().expect("ended").code();
        (killed.success(), code)
    };
    // A long run is stopped for sure.
    let sandbox = Sandbox::new();
    sandbox.set("[poses]", "identification", "100000");
    assert_eq!(interrupted(&sandbox, Duration::from_secs(1)), (true, Some(1)), "ended by the signal");
    assert!(FILES.iter().all(|file| sandbox.read(&format!("out/{file}")) == "old"));
    // A short one at any moment, or not at all.
    let sandbox = Sandbox::new();
    for step in 0..20 {
        let (_, code) = interrupted(&sandbox, Duration::from_millis(15 * step));
        // Before the handler is set, in the session or behind it, or not at all.
        assert!(matches!(code, None | Some(0 | 1)), "{code:?}");
        assert_whole(&sandbox, &reference, &format!("after {} ms", 15 * step));
    }
}

#[test]
fn run_tells_what_each_part_of_the_machine_contributes() {
    let sandbox = Sandbox::new();
    sandbox.set("[poses]", "identification", "20");
    sandbox.set("[poses]", "verification", "5");
    let backlash = "[[effects.backlash.joint]]\njoint = \"shoulder\"\ngap_arcsec = 60\n";
    sandbox.write("scenarios/backlash.toml", format!("{}\n{backlash}", sandbox.read(SCENARIO)));
    let run = ["run", "scenarios/backlash.toml", "--out", "out", "--ablate", "--json"];
    let ended = sandbox.run(run);
    assert!(matches!(ended.code, Some(0 | 3)), "{ended:?}");
    let json = ended.json();
    let parts = json["ablation"]["parts"].as_array().expect("a list");
    let part = parts.iter().find(|part| part["key"] == "backlash").expect("the machine has it");
    let change = &part["rows"]["verification"]["with_gravity"]["rms_3d_change_m"];
    assert!(change.as_f64().is_some_and(|change| change != 0.0), "{part}");
    assert!(sandbox.read("out/report.html").contains("id=\"ablation\""));
    // Without the flag there is nothing of it.
    let plain = sandbox.run(["run", "scenarios/backlash.toml", "--out", "plain", "--json"]).json();
    assert!(plain.get("ablation").is_none());
    assert_eq!(plain["sets"], json["sets"]);
}
