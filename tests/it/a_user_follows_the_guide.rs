//! The README and the pages of docs/guide: their commands are run, their output is what they show, and every file and heading that a page links to is there.
//!
//! A block fenced as `console` is run line by line behind `$ `, in one folder a page; the lines below a command are what it prints, as a whole or in part. `...`
//! stands for any text within a line, and alone for any lines. A block fenced as `toml NAME`, `csv NAME` or `awk NAME` is a file of that name. All others are not run.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::sandbox::{Ended, Sandbox};

const WARNINGS: &str = "docs/guide/reading-the-report.md";
/// A command that ends otherwise than with 0 says so behind it.
const ENDS: &str = "# exit code ";

fn root() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR"))
}

fn page(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
}

#[derive(Debug)]
enum Step {
    /// A file of the page.
    File { name: String, text: String },
    /// A command, how it ends, and what it shows.
    Command { line: usize, words: String, code: i32, shown: Vec<String> },
}

fn steps(text: &str) -> Vec<Step> {
    let mut steps = Vec::new();
    let mut lines = text.lines().enumerate();
    while let Some((_, line)) = lines.next() {
        let Some(info) = line.strip_prefix("```") else { continue };
        let block: Vec<_> = lines.by_ref().take_while(|(_, line)| !line.starts_with("```")).collect();
        match info.split_once(' ').unwrap_or((info, "")) {
            ("console", _) => steps.extend(commands(&block)),
            ("toml" | "csv" | "awk", name) if !name.is_empty() => {
                let text = block.iter().flat_map(|(_, line)| [*line, "\n"]).collect();
                steps.push(Step::File { name: name.to_owned(), text });
            }
            _ => {}
        }
    }
    steps
}

fn commands(block: &[(usize, &str)]) -> Vec<Step> {
    let mut steps: Vec<Step> = Vec::new();
    for (number, line) in block {
        if let Some(words) = line.strip_prefix("$ ") {
            let (words, code) = words.split_once(ENDS).unwrap_or((words, "0"));
            let code = code.trim().parse().unwrap_or_else(|error| panic!("line {}: {error}", number + 1));
            steps.push(Step::Command {
                line: number + 1,
                words: words.trim().to_owned(),
                code,
                shown: Vec::new(),
            });
        } else {
            match steps.last_mut() {
                Some(Step::Command { shown, .. }) => shown.push(line.trim_end().to_owned()),
                _ => panic!("line {}: output without a command", number + 1),
            }
        }
    }
    steps
}

/// The program as a reader of the page has it: `calibrig`, or built by cargo.
fn in_shell(sandbox: &Sandbox, words: &str) -> Ended {
    let binary = Path::new(env!("CARGO_BIN_EXE_calibrig"));
    let folder = binary.parent().expect("a folder");
    let path = std::env::var_os("PATH").unwrap_or_default();
    let path =
        std::env::join_paths(std::iter::once(folder.to_path_buf()).chain(std::env::split_paths(&path)));
    Command::new("sh")
        .args(["-c", &words.replace("cargo run --release -- ", "calibrig ")])
        .current_dir(sandbox.path(""))
        .env("PATH", path.expect("a path"))
        .stdin(Stdio::null())
        .output()
        .expect("a shell")
        .into()
}

/// Whether a line is as it is shown, where `...` stands for any text.
fn fits(line: &str, shown: &str) -> bool {
    let parts: Vec<_> = shown.split("...").collect();
    let [first, between @ .., last] = parts.as_slice() else { return line == shown };
    let Some(rest) = line.strip_prefix(first).and_then(|rest| rest.strip_suffix(last)) else { return false };
    between.iter().try_fold(rest, |rest, part| rest.split_once(part).map(|(_, rest)| rest)).is_some()
}

/// The first line that is shown and not there.
fn missing<'a>(shown: &'a [String], output: &str) -> Option<&'a str> {
    let lines: Vec<_> = output.lines().map(str::trim_end).collect();
    let mut from = 0;
    for run in shown.split(|line| line == "...").filter(|run| !run.is_empty()) {
        let fit =
            |at: usize| run.iter().zip(&lines[at..]).take_while(|(shown, line)| fits(line, shown)).count();
        match (from..lines.len()).find(|at| fit(*at) == run.len()) {
            Some(at) => from = at + run.len(),
            None => {
                let most = (from..lines.len()).map(fit).max().unwrap_or(0);
                return Some(&run[most]);
            }
        }
    }
    None
}

fn follow(name: &str) {
    let sandbox = Sandbox::as_shipped();
    let steps = steps(&page(name));
    assert!(
        steps.iter().any(|step| matches!(step, Step::Command { .. })),
        "{name} shows no command that is run"
    );
    for step in steps {
        match step {
            Step::File { name, text } => sandbox.write(&name, text),
            Step::Command { line, words, code, shown } => {
                let ended = in_shell(&sandbox, &words);
                let place = format!("{name}:{line}: {words}");
                assert_eq!(ended.code, Some(code), "{place}\n{}{}", ended.stdout, ended.stderr);
                let output = format!("{}{}", ended.stdout, ended.stderr);
                if let Some(line) = missing(&shown, &output) {
                    panic!("{place}\ndoes not print, at its place,\n{line}\nbut\n{output}");
                }
            }
        }
    }
}

#[test]
fn the_readme_is_what_happens() {
    follow("README.md");
}

#[test]
fn the_published_experiment_is_what_happens() {
    follow("docs/guide/published-experiment.md");
}

#[test]
fn a_robot_of_ones_own_is_what_happens() {
    follow("docs/guide/your-robot.md");
}

#[test]
fn reading_the_report_is_what_happens() {
    follow(WARNINGS);
}

#[test]
fn planning_and_compensating_is_what_happens() {
    follow("docs/guide/plan-and-compensate.md");
}

#[test]
fn a_study_is_what_happens() {
    follow("docs/guide/study.md");
}

#[test]
fn the_twin_of_the_ur5_is_made_as_its_page_says() {
    follow("docs/guide/sim-against-real.md");
}

/// A new page is run as well.
#[test]
fn every_page_of_the_guide_is_followed() {
    let own = fs::read_to_string(root().join("tests/it/a_user_follows_the_guide.rs")).expect("this file");
    for entry in fs::read_dir(root().join("docs/guide")).expect("the guide") {
        let name = entry.expect("a page").file_name().into_string().expect("a name");
        assert!(own.contains(&format!("docs/guide/{name}\"")), "no test follows docs/guide/{name}");
    }
}

#[test]
fn lines_are_compared_with_what_is_shown() {
    assert!(fits("rank 33 of 33, condition 526", "rank ... of ..., condition 526"));
    assert!(!fits("rank 33 of 33, condition 527", "rank ... of ..., condition 526"));
    assert!(fits("as it is", "as it is") && !fits("as it is not", "as it is"));
    let shown = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(missing(&shown("b\n...\nd"), "a\nb\nc\nd\n"), None);
    assert_eq!(missing(&shown("b\nd"), "a\nb\nc\nd\n"), Some("d"));
    assert_eq!(missing(&shown("d\n...\nb"), "a\nb\nc\nd\n"), Some("b"));
}

// What the pages must hold.

/// Every command stands in the table of the README, once.
#[test]
fn the_readme_has_every_command_once() {
    let help = Sandbox::new().run(["--help"]).stdout;
    let (_, list) = help.split_once("Commands:\n").expect("commands");
    let (list, _) = list.split_once("\n\n").expect("options behind them");
    let names: BTreeSet<_> = list
        .lines()
        .filter_map(|line| line.strip_prefix("  "))
        .filter(|l| !l.starts_with(' '))
        .filter_map(|line| line.split(' ').next())
        .filter(|name| *name != "help")
        .collect();
    assert!(names.len() > 15, "{names:?}");
    let readme = page("README.md");
    let (_, table) = readme.split_once("\n## Commands\n").expect("the table");
    let (table, _) = table.split_once("\n## ").unwrap_or((table, ""));
    let mut counted: BTreeMap<&str, usize> = names.iter().map(|name| (*name, 0)).collect();
    for cell in
        table.lines().filter_map(|line| line.strip_prefix("| ")).filter_map(|line| line.split(" | ").next())
    {
        let of_row: BTreeSet<_> =
            cell.split(['`', ' ', ',', '[', ']']).filter(|word| names.contains(word)).collect();
        for name in of_row {
            *counted.entry(name).or_default() += 1;
        }
    }
    assert!(counted.values().all(|count| *count == 1), "{counted:?}");
}

/// `NotConverged` as `not_converged`.
fn snake(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// Variants of the enum `name` of a source file, each with what stands in front of it, in one line.
fn variants(source: &str, name: &str) -> Vec<(String, String)> {
    let (_, body) = source.split_once(&format!("pub enum {name} {{\n")).expect("the enum");
    let (body, _) = body.split_once("\n}\n").expect("its end");
    let (mut found, mut before) = (Vec::new(), String::new());
    for line in body.lines() {
        let own = line.strip_prefix("    ").filter(|line| line.starts_with(|c: char| c.is_ascii_uppercase()));
        if let Some(own) = own {
            let end = own.find(|c: char| !c.is_ascii_alphanumeric()).unwrap_or(own.len());
            found.push((snake(&own[..end]), std::mem::take(&mut before)));
        } else {
            before.push_str(line.trim().trim_end_matches('\\'));
            before.push(' ');
        }
    }
    found
}

/// A row for each warning of an estimate, whose words are those of the program.
#[test]
fn every_warning_is_explained() {
    let source = page("crates/calibrig-estimation/src/identification/estimate.rs");
    let guide = page(WARNINGS);
    let plain = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let all = variants(&source, "Warning");
    assert!(all.len() > 15, "{all:?}");
    for (key, text) in all {
        let rows: Vec<_> = guide.lines().filter(|line| line.starts_with(&format!("| `{key}`"))).collect();
        let [row] = rows.as_slice() else { panic!("{WARNINGS}: {} rows of {key}", rows.len()) };
        let quoted = row.split('"').nth(1).unwrap_or_else(|| panic!("{key} is not quoted in {row}"));
        for part in quoted.split("...").map(str::trim).filter(|part| !part.is_empty()) {
            assert!(plain(&text).contains(part), "{key} does not say {part:?} but {text}");
        }
    }
    for (key, _) in variants(&page("crates/calibrig-estimation/src/evaluation/patterns/mod.rs"), "Cause") {
        assert!(guide.contains(&format!("| `{key}")), "{WARNINGS}: no row of the pattern {key}");
    }
}

/// Files of the repository that are pages; none of what runs and builds left.
fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder") {
        let entry = entry.expect("an entry");
        let (path, name) = (entry.path(), entry.file_name().into_string().expect("a name"));
        if name.starts_with('.') || ["target", "runs", "out"].contains(&name.as_str()) {
            continue;
        }
        if path.is_dir() {
            pages(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "md") {
            found.push(path);
        }
    }
}

/// The text without blocks and code, where nothing is a link.
fn prose(text: &str) -> String {
    let mut inside = false;
    let mut prose = String::new();
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            inside = !inside;
        } else if !inside && !line.starts_with("    ") {
            prose.extend(line.split('`').step_by(2));
            prose.push('\n');
        }
    }
    prose
}

/// The names by which headings are linked to, as GitHub makes them.
fn anchors(text: &str) -> BTreeSet<String> {
    let (mut inside, mut found) = (false, BTreeSet::new());
    for line in text.lines() {
        inside ^= line.starts_with("```");
        let heading = line.trim_start_matches('#');
        if inside || heading.len() == line.len() || !heading.starts_with(' ') {
            continue;
        }
        let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
        let name: String = heading.trim().to_lowercase().chars().filter(kept).collect();
        let name = name.replace(' ', "-");
        let further = (1..).map(|k| format!("{name}-{k}"));
        let free = std::iter::once(name.clone()).chain(further).find(|name| !found.contains(name));
        found.extend(free);
    }
    found
}

#[test]
fn every_link_between_pages_leads_somewhere() {
    let mut all = Vec::new();
    pages(&root(), &mut all);
    assert!(all.len() > 30, "{all:?}");
    let (mut seen, mut broken) = (0, Vec::new());
    for path in &all {
        let text = prose(&fs::read_to_string(path).expect("a page"));
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if link.contains("://") || link.starts_with("mailto:") {
                continue;
            }
            seen += 1;
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { path.clone() } else { path.with_file_name("").join(file) };
            let there = target.exists()
                && (anchor.is_empty()
                    || fs::read_to_string(&target).is_ok_and(|text| anchors(&text).contains(anchor)));
            if !there {
                broken.push(format!("{}: {link}", path.display()));
            }
        }
    }
    assert!(seen > 60, "{seen} links");
    assert!(broken.is_empty(), "links that lead nowhere:\n{}", broken.join("\n"));
}
