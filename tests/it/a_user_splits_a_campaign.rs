//! A campaign is the same bits however it is shared out, stopped and mended; what must not be merged is named.

use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use std::time::Duration;

use calibrig::campaign::table::{Cell, Table, TableReader};
use calibrig::montecarlo::{Campaign, TrialColumns};
use calibrig::pipeline::PlantKind;
use calibrig::scenario::load_scenario;

use crate::sandbox::{Ended, Sandbox, assert_refused};

const SCENARIO: &str = "scenarios/matched.toml";

/// A scenario of few poses, whose trials take milliseconds.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    sandbox.replace_line(SCENARIO, "", "identification = ", "identification = 12");
    sandbox.replace_line(SCENARIO, "", "verification = ", "verification = 4");
    sandbox
}

fn campaign(sandbox: &Sandbox, out: &str, more: &[&str]) -> Ended {
    let arguments = ["montecarlo", SCENARIO, "--plant", "analytic", "--out", out];
    sandbox.run(arguments.iter().chain(more))
}

fn table(sandbox: &Sandbox, out: &str) -> Vec<u8> {
    fs::read(sandbox.path(&format!("{out}/trials.parquet"))).expect("a table")
}

fn whole(sandbox: &Sandbox, trials: &str) -> Vec<u8> {
    let ended = campaign(sandbox, "whole", &["--trials", trials]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    table(sandbox, "whole")
}

#[test]
fn threads_shards_and_single_trials_give_the_same_bits() {
    let sandbox = sandbox();
    let one = whole(&sandbox, "41");
    for threads in ["1", "2", "8"] {
        let ended = campaign(&sandbox, threads, &["--trials", "41", "--threads", threads]);
        assert_eq!(ended.code, Some(0), "{ended:?}");
        assert!(table(&sandbox, threads) == one, "{threads} threads");
        assert_eq!(sandbox.read(&format!("{threads}/summary.json")), sandbox.read("whole/summary.json"));
    }
    for shards in [1_u32, 7, 40] {
        let out = format!("in-{shards}");
        // In any order.
        for shard in (0..shards).rev() {
            let ended =
                campaign(&sandbox, &out, &["--trials", "41", "--shard", &format!("{shard}/{shards}")]);
            assert_eq!(ended.code, Some(0), "{ended:?}");
        }
        let again = campaign(&sandbox, &out, &["--trials", "41", "--shard", &format!("0/{shards}")]);
        assert!(again.code == Some(0) && again.stderr.contains("nothing to do"), "{again:?}");
        let missing = sandbox.run(["missing", &out]);
        assert_eq!((missing.code, missing.stdout.as_str()), (Some(0), ""), "{missing:?}");
        let merged = sandbox.run(["merge", &out]);
        assert_eq!(merged.code, Some(0), "{merged:?}");
        assert!(table(&sandbox, &out) == one, "{shards} shards");
        assert_eq!(sandbox.read(&format!("{out}/summary.json")), sandbox.read("whole/summary.json"));
    }

    // Any trial alone, by the library.
    let scenario = load_scenario(&sandbox.path(SCENARIO)).expect("the scenario");
    let campaign = Campaign::of_draws(&scenario, scenario.seed, PlantKind::Analytic);
    let columns = TrialColumns::of(&campaign);
    let reader = TableReader::open(&sandbox.path("whole/trials.parquet")).expect("a table");
    assert_eq!(reader.columns(), columns.columns());
    let all: Vec<usize> = (0..columns.columns().len()).collect();
    for trial in [0, 7, 40] {
        let mut row = Vec::new();
        reader.visit(&all, trial..trial + 1, &mut |cells| row = cells.to_vec()).expect("a row");
        assert_eq!((&row[0], &row[2]), (&Cell::count(trial), &Cell::text("ok")));
        assert_eq!(columns.row(&campaign.trial(trial)), row, "trial {trial} alone");
    }
}

#[test]
fn a_campaign_that_is_killed_twenty_times_goes_on_to_the_same_bits() {
    let sandbox = sandbox();
    let one = whole(&sandbox, "3000");
    let mut kept = Vec::new();
    let mut number = 7_u64;
    for _ in 0..20 {
        let resume: &[&str] = if sandbox.path("out/manifest.json").exists() { &["--resume"] } else { &[] };
        let arguments = [
            "montecarlo",
            SCENARIO,
            "--plant",
            "analytic",
            "--trials",
            "3000",
            "--threads",
            "1",
            "--out",
            "out",
        ];
        let mut command = sandbox.command(arguments.iter().chain(resume));
        let mut child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the binary");
        // Some moments between 0.1 and 1.7 s.
        number = number.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        std::thread::sleep(Duration::from_millis(100 + (number >> 33) % 1600));
        child.kill().expect("a process");
        child.wait().expect("an end");
        let named = |entry: &fs::DirEntry| entry.path().extension().is_some_and(|end| end == "parquet");
        let entries = fs::read_dir(sandbox.path("out/parts")).into_iter().flatten().flatten();
        let is_open = !sandbox.path("out/trials.parquet").exists();
        kept.push(if is_open { entries.filter(named).count() } else { 0 });
    }
    println!("parts after each kill while there was no table: {kept:?}");
    // Most of the kills fall into the work, and what was done before is kept.
    let in_work = kept.iter().filter(|parts| **parts > 0).count();
    assert!(in_work >= 8 && kept.windows(2).all(|pair| pair[1] >= pair[0] || pair[1] == 0), "{kept:?}");
    let ended = campaign(&sandbox, "out", &["--trials", "3000", "--resume"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(table(&sandbox, "out") == one, "not the same bits");
    assert!(!sandbox.path("out/parts").exists(), "parts are left");
    // Once more: nothing is done twice, and it is summed up again.
    let again = campaign(&sandbox, "out", &["--trials", "3000", "--resume", "--tolerance", "1mm"]);
    assert!(again.code == Some(0) && again.stderr.contains("are there already"), "{again:?}");
    assert!(again.stdout.contains("within 1 mm"), "{}", again.stdout);
}

#[cfg(unix)]
#[test]
fn an_interrupt_keeps_what_is_done_and_says_how_to_go_on() {
    let sandbox = sandbox();
    let arguments = ["montecarlo", SCENARIO, "--trials", "100000", "--plant", "analytic", "--out", "out"];
    let mut command = sandbox.command(arguments);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the binary starts");
    let parts = || fs::read_dir(sandbox.path("out/parts")).map_or(0, Iterator::count);
    // Two minutes on an idle machine, more on a busy one.
    let written = (0..6000).any(|_| {
        std::thread::sleep(Duration::from_millis(20));
        parts() >= 2
    });
    assert!(written, "no part was written");
    let sent = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.expect("kill").success());
    let ended = child.wait_with_output().expect("an end");
    let stderr = String::from_utf8_lossy(&ended.stderr);
    assert_eq!(ended.status.code(), Some(3), "{stderr}");
    assert!(stderr.contains("doubtful: interrupted, ") && stderr.contains("--resume"), "{stderr}");
    assert!(String::from_utf8_lossy(&ended.stdout).starts_with("campaign of "), "no tables");
    assert!(parts() >= 1, "nothing is kept");
    let missing = sandbox.run(["missing", "out"]);
    assert_eq!((missing.code, missing.stdout.as_str()), (Some(3), "0\n"), "{missing:?}");
    let merged = sandbox.run(["merge", "out"]);
    assert_eq!(merged.code, Some(3), "{merged:?}");
    assert!(!sandbox.path("out/trials.parquet").exists());
}

/// The one file among the shards whose name has `what` in it.
fn shard(sandbox: &Sandbox, out: &str, what: &str) -> PathBuf {
    let entries = fs::read_dir(sandbox.path(&format!("{out}/shards"))).expect("shards");
    let named = entries.map(|entry| entry.expect("an entry").path()).filter(|path| {
        path.extension().is_some_and(|e| e == "parquet") && path.to_string_lossy().contains(what)
    });
    let [path] = &named.collect::<Vec<_>>()[..] else { panic!("not one shard {what}") };
    path.clone()
}

#[test]
fn every_fault_among_the_shards_is_named_and_nothing_is_merged() {
    let sandbox = sandbox();
    let one = whole(&sandbox, "12");
    let run = |out: &str, of: &str, seed: &str| {
        let ended = campaign(&sandbox, out, &["--trials", "12", "--seed", seed, "--shard", of]);
        assert_eq!(ended.code, Some(0), "{ended:?}");
    };
    for number in 0..4 {
        run("out", &format!("{number}/4"), "1");
    }
    run("seed", "2/4", "2");
    run("split", "1/3", "1");
    let cut = shard(&sandbox, "out", "-000001-of-");
    let bytes = fs::read(&cut).expect("a shard");
    fs::write(&cut, &bytes[..bytes.len() - 1]).expect("room");
    fs::remove_file(shard(&sandbox, "out", "-000003-of-")).expect("a shard");
    let put = |from: PathBuf| {
        let name = from.file_name().expect("a name").to_owned();
        fs::copy(&from, sandbox.path("out/shards").join(&name)).expect("room");
        name.to_string_lossy().into_owned()
    };
    let foreign = put(shard(&sandbox, "seed", "-000002-of-"));
    let overlap = put(shard(&sandbox, "split", "-000001-of-"));

    let missing = sandbox.run(["missing", "out"]);
    assert_eq!((missing.code, missing.stdout.as_str()), (Some(3), "1,3\n"), "{missing:?}");
    let cut_name = cut.file_name().expect("a name").to_string_lossy().into_owned();
    for words in [&cut_name, "cut short", &foreign, "seed 2 instead of 1", &overlap, "overlap"] {
        assert!(missing.stderr.contains(words), "{words} is not in {}", missing.stderr);
    }
    let merged = sandbox.run(["merge", "out"]);
    assert_eq!((merged.code, merged.stdout.as_str()), (Some(1), ""), "{merged:?}");
    assert!(merged.stderr.contains("2 files among the shards must not be merged"), "{}", merged.stderr);
    assert!(!sandbox.path("out/trials.parquet").exists());

    for name in [foreign, overlap] {
        fs::remove_file(sandbox.path("out/shards").join(name)).expect("a file");
    }
    let merged = sandbox.run(["merge", "out"]);
    assert_eq!((merged.code, merged.stdout.as_str()), (Some(3), ""), "{merged:?}");
    assert!(
        merged.stderr.contains("2 of 4 shards are missing, so no table is made: 1,3"),
        "{}",
        merged.stderr
    );
    for number in ["1/4", "3/4"] {
        run("out", number, "1");
    }
    assert_eq!(sandbox.run(["merge", "out"]).code, Some(0));
    assert!(table(&sandbox, "out") == one);
}

#[test]
fn two_campaigns_do_not_share_a_folder_and_what_is_there_is_untouched() {
    let sandbox = sandbox();
    whole(&sandbox, "3");
    let before = sandbox.content();
    for (more, message, expected) in [
        (&["--trials", "3"][..], "this folder holds a campaign already", "--resume"),
        (
            &["--trials", "4", "--resume"],
            "it has 3 trials from 0 instead of 4 trials from 0",
            "another folder",
        ),
        (&["--trials", "3", "--seed", "2", "--resume"], "it has seed 1 instead of 2", "another folder"),
        (&["--trials", "3", "--shard", "0/2"], "it has shards: 1 instead of 2", "another folder"),
    ] {
        let arguments = [&["montecarlo", SCENARIO, "--plant", "analytic", "--out", "whole"], more].concat();
        assert_refused(&sandbox, &arguments, "whole", message, expected);
        assert!(sandbox.content() == before, "{more:?}");
    }
    // Another program: what it computes may differ in the last bit.
    let manifest = sandbox.read("whole/manifest.json");
    let key = manifest.find("binary_sha256").expect("the key") + "binary_sha256\": \"".len();
    let mut other = manifest.clone();
    let digit = if &manifest[key..=key] == "0" { "1" } else { "0" };
    other.replace_range(key..=key, digit);
    sandbox.write("whole/manifest.json", &other);
    let resumed =
        ["montecarlo", SCENARIO, "--plant", "analytic", "--trials", "3", "--out", "whole", "--resume"];
    assert_refused(&sandbox, &resumed, "whole", "a different build of version", "another folder");

    for (text, message) in
        [("", "it is empty or cut short"), ("{}", "missing field"), ("[1]", "manifest.json")]
    {
        sandbox.write("whole/manifest.json", text);
        for command in [&["missing", "whole"][..], &["merge", "whole"], &resumed] {
            assert_refused(&sandbox, command, "whole/manifest.json", message, "start the campaign again");
        }
    }
    sandbox.make_folder("nothing");
    for command in ["missing", "merge"] {
        assert_refused(&sandbox, &[command, "nothing"], "nothing", "no campaign here", "--out DIR");
    }
    let resumed = ["montecarlo", SCENARIO, "--trials", "3", "--out", "nothing", "--resume"];
    assert_refused(&sandbox, &resumed, "nothing", "no campaign here", "--out DIR");
}

#[test]
fn a_table_that_was_altered_is_made_again_and_one_of_nobody_is_kept() {
    let sandbox = sandbox();
    let one = whole(&sandbox, "6");
    let path = sandbox.path("whole/trials.parquet");
    for place in [one.len() / 3, one.len() / 2, one.len() - 9] {
        let mut altered = one.clone();
        altered[place] ^= 0x40;
        fs::write(&path, &altered).expect("room");
        let missing = sandbox.run(["missing", "whole"]);
        assert_eq!(missing.code, Some(3), "{missing:?}");
        assert!(missing.stderr.contains("cut short, altered"), "{}", missing.stderr);
        let merged = sandbox.run(["merge", "whole"]);
        assert!(merged.code == Some(3) && merged.stderr.contains("--resume to continue"), "{merged:?}");
        let again = campaign(&sandbox, "whole", &["--trials", "6", "--resume"]);
        assert!(again.code == Some(0) && again.stderr.contains("cut short, altered"), "{again:?}");
        assert!(table(&sandbox, "whole") == one);
    }
    // The manifest is gone: whose table it is nobody can tell.
    fs::remove_file(sandbox.path("whole/manifest.json")).expect("a manifest");
    let arguments = ["montecarlo", SCENARIO, "--plant", "analytic", "--trials", "6", "--out", "whole"];
    assert_refused(&sandbox, &arguments, "whole/trials.parquet", "exists already", "another name");
}

#[test]
fn several_processes_at_one_shard_end_well() {
    let sandbox = sandbox();
    let arguments =
        ["montecarlo", SCENARIO, "--plant", "analytic", "--trials", "600", "--shard", "0/1", "--out", "out"];
    let children: Vec<_> = (0..3)
        .map(|n| {
            std::thread::sleep(Duration::from_millis(300 * n));
            let mut command = sandbox.command(arguments);
            command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the binary starts")
        })
        .collect();
    for child in children {
        let ended = child.wait_with_output().expect("an end");
        assert_eq!(ended.status.code(), Some(0), "{}", String::from_utf8_lossy(&ended.stderr));
    }
    let merged = sandbox.run(["merge", "out"]);
    assert_eq!(merged.code, Some(0), "{merged:?}");
    assert!(table(&sandbox, "out") == whole(&sandbox, "600"));
}

#[test]
fn job_files_run_every_shard() {
    let sandbox = sandbox();
    for (scheduler, file) in
        [("slurm", "slurm.sh"), ("hyperqueue", "hyperqueue.sh"), ("kubernetes", "kubernetes.yaml")]
    {
        let out = format!("on {scheduler}");
        let more = ["--trials", "8", "--plan", scheduler, "--shards", "2", "--seed", "5"];
        let ended = campaign(&sandbox, &out, &more);
        assert_eq!(ended.code, Some(0), "{ended:?}");
        for words in ["run the shards:", "missing", "merge"] {
            assert!(ended.stdout.contains(words), "{}", ended.stdout);
        }
        let text = sandbox.read(&format!("{out}/{file}"));
        assert!(text.contains("--seed") && text.contains("analytic"), "{text}");
        assert_eq!(sandbox.run(["missing", &out]).stdout, "0-1\n");
    }
    // What the scheduler's tasks do.
    let script = sandbox.path("on slurm/slurm.sh");
    for task in ["0", "1"] {
        let ended = std::process::Command::new("bash").arg(&script).env("SLURM_ARRAY_TASK_ID", task).output();
        let ended = ended.expect("bash");
        assert!(ended.status.success(), "{}", String::from_utf8_lossy(&ended.stderr));
    }
    assert_eq!(sandbox.run(["merge", "on slurm"]).code, Some(0));
    assert_eq!(campaign(&sandbox, "one", &["--trials", "8", "--seed", "5"]).code, Some(0));
    assert!(table(&sandbox, "on slurm") == table(&sandbox, "one"));
}

/// Where the tests run with the readers of other programs.
#[test]
fn duckdb_reads_the_table() {
    let has = std::process::Command::new("python3").args(["-c", "import duckdb"]).output();
    if !has.is_ok_and(|output| output.status.success()) {
        eprintln!("SKIPPED: no python3 with duckdb (pip install duckdb)");
        return;
    }
    let sandbox = sandbox();
    let ended = campaign(&sandbox, "out", &["--trials", "9", "--csv"]);
    assert_eq!(ended.code, Some(0), "{ended:?}");
    // The same numbers to the bit as in the text file, whose numbers Python reads to the bit.
    let program = "import csv, duckdb, sys\n\
        table = duckdb.sql(f\"select * from '{sys.argv[1]}'\"); names = table.columns; rows = table.fetchall()\n\
        text = list(csv.reader(open(sys.argv[2], newline='')))\n\
        assert names == text[0] and len(rows) == len(text) - 1 == 9\n\
        def same(cell, written):\n    \
            return written == '' if cell is None else cell == type(cell)(written)\n\
        for row, cells in zip(rows, text[1:]):\n    \
            assert all(map(same, row, cells)), row\n\
        assert sum(type(cell) is float for row in rows for cell in row) > 1000\n\
        print(len(rows), 'rows of', len(names), 'columns')";
    let out = |name: &str| sandbox.path(&format!("out/{name}"));
    let mut read = std::process::Command::new("python3");
    read.args(["-c", program]).args([out("trials.parquet"), out("trials.csv")]);
    let output = read.output().expect("python3");
    print!("{}", String::from_utf8_lossy(&output.stdout));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}
