//! Job files: the shards of a campaign as a job array of Slurm, `HyperQueue` or Kubernetes.
//!
//! A scheduler only runs shards. What is done is decided by the shards' files (`calibrig missing`), never by the scheduler. `docs/cluster.md`
//! says which of these files were run, with which versions.
//!
//! ```
//! use std::path::PathBuf;
//! use calibrig_campaign::plan::{JobPlan, Scheduler};
//!
//! let plan = JobPlan {
//!     program: PathBuf::from("/opt/calibrig"),
//!     folder: PathBuf::from("/home/jo/my robot"),
//!     scenario: PathBuf::from("scenario.toml"),
//!     trials: 10_000,
//!     arguments: vec!["--plant".into(), "analytic".into()],
//!     threads: 4,
//!     shards: 100,
//!     out: PathBuf::from("/scratch/jo/campaign"),
//! };
//! let script = plan.job_file(Scheduler::Slurm)?;
//! assert!(script.contains("\n#SBATCH --array=0-99\n"));
//! assert!(script.contains("\ncd '/home/jo/my robot' || exit 1\n"));
//! # Ok::<(), calibrig_campaign::plan::PlanError>(())
//! ```

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Folder for the tasks' output, below the campaign's folder. Slurm does not create it: the writer of the job file
/// does.
pub const LOGS: &str = "logs";
/// Most tasks of an array in a Slurm with default settings (its `MaxArraySize` of 1001: the largest number is 1000).
const SLURM_TASKS: u32 = 1001;
/// Most pods of a job at the same time, unless it is adapted.
const PODS: u32 = 100;
/// Letters of a job's name: Kubernetes builds names of at most 63 from it and a number.
const NAME: usize = 40;

/// What runs the shards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scheduler {
    /// A job array of `sbatch`.
    Slurm,
    /// A task array of `hq submit`.
    HyperQueue,
    /// An indexed `Job` of `batch/v1`.
    Kubernetes,
}

impl Scheduler {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Slurm, Self::HyperQueue, Self::Kubernetes];

    /// As it is named in commands.
    pub const fn key(self) -> &'static str {
        match self {
            Self::Slurm => "slurm",
            Self::HyperQueue => "hyperqueue",
            Self::Kubernetes => "kubernetes",
        }
    }

    /// The name of its job file, in the campaign's folder. `HyperQueue` reads the settings in a script whose name ends with `.sh`.
    pub const fn file_name(self) -> &'static str {
        match self {
            Self::Slurm => "slurm.sh",
            Self::HyperQueue => "hyperqueue.sh",
            Self::Kubernetes => "kubernetes.yaml",
        }
    }
}

/// A campaign in shards, as described to a scheduler.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JobPlan {
    /// The path of `calibrig` on the machines that run the shards.
    pub program: PathBuf,
    /// The folder to which relative paths of the scenario and of `arguments` refer: an absolute path.
    pub folder: PathBuf,
    /// The scenario file.
    pub scenario: PathBuf,
    /// Trials of the campaign.
    pub trials: u64,
    /// What else determines the campaign, as flags of `calibrig montecarlo` (`--seed 7`): not trials, threads, shard or folder.
    pub arguments: Vec<String>,
    /// Threads of a shard, at least one: the processors that a task asks for.
    pub threads: u16,
    /// Shards of the campaign, at least one: the tasks of the array.
    pub shards: u32,
    /// The campaign's folder: an absolute path, the same on all machines.
    pub out: PathBuf,
}

/// Why there is no job file.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// No scheduler takes an empty array.
    #[error(
        "a campaign for a scheduler needs at least one shard and one thread per shard (here {shards} and {threads})"
    )]
    Nothing {
        /// Shards that were asked for.
        shards: u32,
        /// Threads that were asked for.
        threads: u16,
    },
    /// Job files are text.
    #[error("'{}' is not UTF-8, which a job file must be: rename the folder or file", .0.display())]
    NotText(PathBuf),
    /// A line break would end a setting, or a comment.
    #[error("{0:?} contains a control character, which a job file cannot hold: rename the folder or file")]
    ControlCharacter(String),
    /// Tasks start in folders of their own.
    #[error("the path '{0}' is relative; a job file needs an absolute path")]
    Relative(String),
    /// Kubernetes refuses it.
    #[error("Kubernetes cannot mount a path with a colon, such as '{0}': rename the folder")]
    Colon(String),
}

impl JobPlan {
    /// The text of the job file, to be written to [`file_name`](Scheduler::file_name) in the campaign's folder, next to a folder
    /// [`LOGS`].
    ///
    /// # Errors
    /// If a path is not text in one line, or a folder's is relative; if there is no shard or no thread.
    pub fn job_file(&self, scheduler: Scheduler) -> Result<String, PlanError> {
        let words = self.words(scheduler)?;
        Ok(match scheduler {
            Scheduler::Slurm => self.slurm(&words),
            Scheduler::HyperQueue => self.hyperqueue(&words),
            Scheduler::Kubernetes => self.kubernetes(&words),
        })
    }

    /// The commands that run the job file, run again what is missing, and make one table of it: lines for a shell.
    ///
    /// # Errors
    /// As [`job_file`](Self::job_file).
    pub fn commands(&self, scheduler: Scheduler) -> Result<Commands, PlanError> {
        Ok(self.words(scheduler)?.commands(scheduler))
    }

    fn words(&self, scheduler: Scheduler) -> Result<Words, PlanError> {
        if self.shards == 0 || self.threads == 0 {
            return Err(PlanError::Nothing { shards: self.shards, threads: self.threads });
        }
        let words = Words {
            program: text(&self.program)?,
            folder: text(&self.folder)?,
            scenario: text(&self.scenario)?,
            out: text(&self.out)?,
            file: text(&self.out.join(scheduler.file_name()))?,
            logs: text(&self.out.join(LOGS))?,
        };
        for argument in &self.arguments {
            one_line(argument)?;
        }
        for (path, word) in [(&self.folder, &words.folder), (&self.out, &words.out)] {
            if !path.is_absolute() {
                return Err(PlanError::Relative(word.clone()));
            }
            if scheduler == Scheduler::Kubernetes && word.contains(':') {
                return Err(PlanError::Colon(word.clone()));
            }
        }
        Ok(words)
    }

    /// The command of a shard; `number` is inserted as it is.
    fn command(&self, words: &Words, number: &str, word: impl Fn(&str) -> String) -> Vec<String> {
        let trials = self.trials.to_string();
        let mut command: Vec<String> =
            ["montecarlo", &words.scenario, "--trials", &trials].map(&word).to_vec();
        command.extend(self.arguments.iter().map(|argument| word(argument)));
        command.extend(["--threads", &self.threads.to_string(), "--shard"].map(&word));
        command.push(format!("\"{number}/{}\"", self.shards));
        command.extend(["--out", &words.out].map(&word));
        command
    }

    /// The head of a job file: what it is, and the commands to type.
    fn head(&self, words: &Words, scheduler: Scheduler, name: &str) -> String {
        let Commands { submit, missing, again, merge } = words.commands(scheduler);
        format!(
            "# A campaign of calibrig in {} shards, for {name}; written by `calibrig montecarlo --plan {}`. Run it:\n#   {submit}\n\
             # Tasks fail, are killed or run out of time; what they finished is kept, whatever the scheduler says of them. What is not there, and why:\n\
             #   {missing}\n# Run that again, until nothing is missing, then make one table of it:\n#   {again}\n#   {merge}\n",
            self.shards,
            scheduler.key(),
        )
    }

    fn slurm(&self, words: &Words) -> String {
        let mut script = format!("#!/bin/bash\n{}", self.head(words, Scheduler::Slurm, "Slurm"));
        if self.shards > SLURM_TASKS {
            let _ = writeln!(
                script,
                "# {} tasks are more than Slurm allows in an array by default ({SLURM_TASKS}). To see your cluster's \
                 limit:\n#   scontrol show config | grep MaxArraySize\n# If it is smaller than {0}, plan again with fewer \
                 shards.",
                self.shards
            );
        }
        let _ = write!(
            script,
            "#SBATCH --job-name={}\n#SBATCH --array=0-{}\n#SBATCH --nodes=1\n#SBATCH --ntasks=1\n#SBATCH --cpus-per-task={}\n",
            self.name(),
            self.shards - 1,
            self.threads,
        );
        script.push_str(
            "#SBATCH --mem=1G\n# Run a task again whose node failed, and go on with its log.\n#SBATCH --requeue\n#SBATCH --open-mode=append\n\
             # A minute before its time is over, a task is told to keep the trials that are done.\n#SBATCH --signal=B:TERM@60\n",
        );
        // In Slurm a backslash turns off all substitutions in the path, and is dropped.
        if words.logs.contains('\\') {
            script.push_str("# Slurm cannot write to a path with a backslash: the output of the tasks goes to slurm-*.out in \
                             the folder where you submit this.\n");
        } else {
            let logs = words.logs.replace('"', "\\\"").replace('%', "%%");
            let _ = writeln!(script, "#SBATCH --output=\"{logs}/slurm-%A_%a.log\"");
        }
        script.push_str(
            "# Adapt to your cluster; one '#' less makes it a setting. `--array=0-99%10` runs ten tasks at a time.\n\
             ##SBATCH --time=01:00:00\n##SBATCH --partition=NAME\n##SBATCH --account=NAME\n\n",
        );
        let command = self.command(words, "$SLURM_ARRAY_TASK_ID", quoted).join(" ");
        let _ = write!(
            script,
            "cd {} || exit 1\n# In place of the shell, so that signals reach it.\nexec {} {command}\n",
            quoted(&words.folder),
            quoted(&words.program),
        );
        script
    }

    fn hyperqueue(&self, words: &Words) -> String {
        let command = self.command(words, "$HQ_TASK_ID", quoted).join(" ");
        let logs = quoted(&words.logs);
        format!(
            "#!/bin/bash\n{}#HQ --name={}\n#HQ --array=0-{}\n#HQ --cpus={}\n#HQ --stdout=none\n#HQ --stderr=none\n\n\
             mkdir -p {logs} || exit 1\nexec >>{logs}/\"hyperqueue-$HQ_JOB_ID-$HQ_TASK_ID.log\" 2>&1\ncd {} || exit 1\nexec {} {command}\n",
            self.head(words, Scheduler::HyperQueue, "HyperQueue"),
            self.name(),
            self.shards - 1,
            self.threads,
            quoted(&words.folder),
            quoted(&words.program),
        )
    }

    fn kubernetes(&self, words: &Words) -> String {
        // `$(NAME)` stands for a variable in a command, `$$` for a dollar.
        let word = |word: &str| yaml(&word.replace('$', "$$"));
        let mut command = vec!["calibrig".to_owned()];
        command.extend(self.command(words, "$(JOB_COMPLETION_INDEX)", word));
        let command: String =
            command.iter().fold(String::new(), |list, word| list + "            - " + word + "\n");
        let (mut mounts, mut volumes) = (String::new(), String::new());
        let mut volume = |name: &str, path: &str| {
            let _ = write!(mounts, "            - name: {name}\n              mountPath: {}\n", yaml(path));
            let _ = write!(
                volumes,
                "        - name: {name}\n          persistentVolumeClaim:\n            claimName: {name}\n"
            );
        };
        volume("folder", &words.folder);
        if !self.out.starts_with(&self.folder) {
            volume("campaign", &words.out);
        }
        format!(
            "{head}\
             # Adapt the lines with CHANGE: an image with the very `calibrig` that wrote this in its PATH, and claims of volumes that many pods write to (ReadWriteMany).\n\
             # They hold what is here in the folders that they are mounted at: the manifest, the scenario and every file that it names.\n\
             apiVersion: batch/v1\nkind: Job\nmetadata:\n  name: {name}\nspec:\n  completionMode: Indexed\n  completions: {shards}\n  \
             parallelism: {pods}\n  # Of one index (Kubernetes 1.29 or newer): a shard that fails ends no other.\n  backoffLimitPerIndex: 3\n  \
             template:\n    spec:\n      restartPolicy: Never\n      # Time to keep the trials that are done.\n      \
             terminationGracePeriodSeconds: 60\n      containers:\n        - name: calibrig\n          \
             image: \"registry.example/calibrig:latest\" # CHANGE\n          workingDir: {folder}\n          command:\n{command}          \
             resources:\n            requests:\n              cpu: \"{threads}\"\n              memory: 1Gi\n            limits:\n              \
             memory: 1Gi\n          volumeMounts:\n{mounts}      volumes: # CHANGE the names of the claims\n{volumes}",
            head = self.head(words, Scheduler::Kubernetes, "Kubernetes"),
            name = self.name(),
            shards = self.shards,
            pods = self.shards.min(PODS),
            folder = yaml(&words.folder),
            threads = self.threads,
        )
    }

    /// A name for the job, of letters that every scheduler takes.
    fn name(&self) -> String {
        let stem = self.scenario.file_stem().unwrap_or_default().to_string_lossy();
        let stem: String = stem
            .chars()
            .map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' })
            .take(NAME)
            .collect();
        format!("calibrig-{stem}").trim_end_matches('-').to_owned()
    }
}

/// Lines for a shell.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Commands {
    /// Runs all shards.
    pub submit: String,
    /// Prints what is missing.
    pub missing: String,
    /// Runs what is missing.
    pub again: String,
    /// Makes one table of all.
    pub merge: String,
}

/// The paths of a plan as text.
struct Words {
    program: String,
    folder: String,
    scenario: String,
    out: String,
    file: String,
    logs: String,
}

impl Words {
    fn commands(&self, scheduler: Scheduler) -> Commands {
        let (program, out, file) = (quoted(&self.program), quoted(&self.out), quoted(&self.file));
        let missing = format!("{program} missing {out}");
        let (submit, again) = match scheduler {
            Scheduler::Slurm => (format!("sbatch {file}"), format!("sbatch --array=\"$({missing})\" {file}")),
            Scheduler::HyperQueue => {
                (format!("hq submit {file}"), format!("hq submit --array=\"$({missing})\" {file}"))
            }
            // A Job takes no list of indices: if a shard is there, its pod ends at once. kubectl gives a comma or quote in a path a special meaning.
            Scheduler::Kubernetes => {
                (format!("kubectl apply -f - <{file}"), format!("kubectl replace --force -f - <{file}"))
            }
        };
        Commands { submit, missing, again, merge: format!("{program} merge {out}") }
    }
}

fn text(path: &Path) -> Result<String, PlanError> {
    one_line(path.to_str().ok_or_else(|| PlanError::NotText(path.to_owned()))?)
}

/// Refuses characters that end a line for a shell or for YAML, and invisible ones.
fn one_line(word: &str) -> Result<String, PlanError> {
    let unseen = |c: char| c.is_control() || "\u{2028}\u{2029}\u{feff}".contains(c);
    if word.contains(unseen) {
        Err(PlanError::ControlCharacter(word.to_owned()))
    } else {
        Ok(word.to_owned())
    }
}

/// A word quoted for a POSIX shell if necessary.
#[must_use]
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// A string of YAML, of a word in one line.
fn yaml(word: &str) -> String {
    format!("\"{}\"", word.replace('\\', "\\\\").replace('"', "\\\""))
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt as _;
    use std::process::Command;

    use super::*;

    /// All that a shell, Slurm, YAML or Kubernetes takes for something else.
    const AWKWARD: &str = "it's \"a\" $HOME $(id) `id` 100%j #x; ~&|*? \u{e9}";

    fn plan(root: &Path) -> JobPlan {
        JobPlan {
            program: root.join(AWKWARD).join("calibrig"),
            folder: root.join(AWKWARD),
            scenario: PathBuf::from(format!("{AWKWARD}.toml")),
            trials: 1000,
            arguments: vec!["--seed".into(), "7".into(), "--note".into(), AWKWARD.into()],
            threads: 3,
            shards: 8,
            out: root.join(format!("out {AWKWARD}")),
        }
    }

    /// Lines of settings, without their mark.
    fn settings<'a>(text: &'a str, mark: &'a str) -> Vec<&'a str> {
        text.lines().filter_map(|line| line.strip_prefix(mark)).collect()
    }

    fn expected(plan: &JobPlan, number: u32) -> Vec<String> {
        let out = plan.out.to_str().unwrap();
        let scenario = plan.scenario.to_str().unwrap();
        let shard = format!("{number}/8");
        [
            "montecarlo",
            scenario,
            "--trials",
            "1000",
            "--seed",
            "7",
            "--note",
            AWKWARD,
            "--threads",
            "3",
            "--shard",
            &shard,
            "--out",
            out,
        ]
        .map(str::to_owned)
        .to_vec()
    }

    /// Writes a program that prints the folder that it is in and its words, one a line.
    fn printer(path: &Path) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "#!/bin/sh\npwd\nprintf '%s\\n' \"$@\"\n").unwrap();
        fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    #[test]
    fn scripts_run_the_shard_of_their_task_whatever_the_paths() {
        let root = tempfile::tempdir().unwrap();
        let plan = plan(root.path());
        printer(&plan.program);
        for (scheduler, number) in
            [(Scheduler::Slurm, "SLURM_ARRAY_TASK_ID"), (Scheduler::HyperQueue, "HQ_TASK_ID")]
        {
            let script = plan.job_file(scheduler).unwrap();
            let file = root.path().join(scheduler.file_name());
            fs::write(&file, &script).unwrap();
            let output =
                Command::new("bash").arg(&file).env(number, "5").env("HQ_JOB_ID", "1").output().unwrap();
            assert!(output.status.success(), "{script}\n{}", String::from_utf8_lossy(&output.stderr));
            let said = match scheduler {
                Scheduler::HyperQueue => fs::read(plan.out.join(LOGS).join("hyperqueue-1-5.log")).unwrap(),
                _ => output.stdout,
            };
            let said = String::from_utf8(said).unwrap();
            let mut lines = said.lines();
            assert_eq!(
                fs::canonicalize(lines.next().unwrap()).unwrap(),
                fs::canonicalize(&plan.folder).unwrap()
            );
            assert_eq!(lines.collect::<Vec<_>>(), expected(&plan, 5), "{script}");
        }
    }

    #[test]
    fn commands_pass_paths_through_a_shell() {
        let root = tempfile::tempdir().unwrap();
        let plan = plan(root.path());
        printer(&plan.program);
        let commands = plan.commands(Scheduler::Slurm).unwrap();
        for (word, command) in [("missing", &commands.missing), ("merge", &commands.merge)] {
            let output = Command::new("bash").arg("-c").arg(command).output().unwrap();
            let said = String::from_utf8(output.stdout).unwrap();
            assert_eq!(
                said.lines().skip(1).collect::<Vec<_>>(),
                [word, plan.out.to_str().unwrap()],
                "{command}"
            );
        }
        // What `missing` prints becomes one word of the line that submits it.
        let line = commands.again.replacen("sbatch", "printf '%s\\n'", 1);
        let said =
            String::from_utf8(Command::new("bash").arg("-c").arg(&line).output().unwrap().stdout).unwrap();
        assert!(
            said.starts_with("--array=")
                && said.ends_with(&format!("{}\n", plan.out.join("slurm.sh").display())),
            "{line}\n{said}"
        );
    }

    #[test]
    fn settings_of_slurm_stand_before_its_first_command() {
        let plan = plan(Path::new("/x"));
        let script = plan.job_file(Scheduler::Slurm).unwrap();
        let commands = script.lines().skip_while(|line| line.is_empty() || line.starts_with('#'));
        assert!(settings(&commands.collect::<Vec<_>>().join("\n"), "#SBATCH ").is_empty(), "{script}");
        let settings = settings(&script, "#SBATCH ");
        for setting in
            ["--array=0-7", "--cpus-per-task=3", "--requeue", "--open-mode=append", "--signal=B:TERM@60"]
        {
            assert!(settings.contains(&setting), "{setting}: {script}");
        }
        // As Slurm 22.05 takes it: in quotes, `\"` and `%%` for the signs themselves.
        let output = settings.iter().find_map(|setting| setting.strip_prefix("--output=")).unwrap();
        let expected =
            format!("{}/{LOGS}/slurm-", plan.out.display()).replace('"', "\\\"").replace('%', "%%");
        assert_eq!(output, format!("\"{expected}%A_%a.log\""));
        let one = JobPlan { shards: 1, out: PathBuf::from("/back\\slash"), ..plan };
        let script = one.job_file(Scheduler::Slurm).unwrap();
        assert!(script.contains("\n#SBATCH --array=0-0\n") && !script.contains("--output"), "{script}");
    }

    #[test]
    fn arrays_beyond_slurms_limit_say_so() {
        let of = |shards| JobPlan { shards, ..plan(Path::new("/x")) }.job_file(Scheduler::Slurm).unwrap();
        assert!(!of(1001).contains("MaxArraySize"));
        assert!(of(1002).contains("\n#   scontrol show config | grep MaxArraySize\n"));
    }

    #[test]
    fn settings_of_hyperqueue_hold_no_path() {
        let script = plan(Path::new("/x")).job_file(Scheduler::HyperQueue).unwrap();
        let expected = ["--array=0-7", "--cpus=3", "--stdout=none", "--stderr=none"];
        assert_eq!(settings(&script, "#HQ ")[1..], expected, "{script}");
    }

    /// The value of a key's first line, or the first item of a list with that start.
    fn value(text: &str, start: &str) -> String {
        let line = text.lines().find_map(|line| line.trim_start().strip_prefix(start)).unwrap();
        // Its escapes are those of JSON.
        serde_json::from_str(line).unwrap()
    }

    #[test]
    fn the_job_of_kubernetes_is_indexed_and_runs_the_shard_of_its_index() {
        let plan = plan(Path::new("/x"));
        let text = plan.job_file(Scheduler::Kubernetes).unwrap();
        for line in [
            "  completionMode: Indexed",
            "  completions: 8",
            "  parallelism: 8",
            "      restartPolicy: Never",
        ] {
            assert!(text.lines().any(|given| given == line), "{line}: {text}");
        }
        assert!(text.lines().all(|line| !line.contains('\t') && line.trim_end() == line), "{text}");
        let words = text.lines().filter_map(|line| line.strip_prefix("            - \""));
        let words: Vec<String> =
            words.map(|word| serde_json::from_str(&format!("\"{word}")).unwrap()).collect();
        let dollars = |word: &String| word.replace('$', "$$");
        let mut expected: Vec<String> = expected(&plan, 5).iter().map(dollars).collect();
        *expected.iter_mut().find(|word| *word == "5/8").unwrap() = "$(JOB_COMPLETION_INDEX)/8".into();
        assert_eq!(words, expected, "{text}");
        assert_eq!(value(&text, "workingDir: "), plan.folder.to_str().unwrap());
        let mounts: Vec<&str> = text.lines().filter(|line| line.contains("mountPath")).collect();
        assert_eq!(mounts.len(), 2, "{text}");
        let inside = JobPlan { out: plan.folder.join("runs"), ..plan };
        let text = inside.job_file(Scheduler::Kubernetes).unwrap();
        assert_eq!(text.matches("mountPath").count(), 1, "{text}");
        assert_eq!(value(&text, "mountPath: "), inside.folder.to_str().unwrap());
    }

    #[test]
    fn names_of_jobs_have_letters_that_every_scheduler_takes() {
        for stem in [AWKWARD, "Paper_floor", "", "---", &"long".repeat(30), "\u{e9}t\u{e9}"] {
            let name =
                JobPlan { scenario: PathBuf::from(format!("{stem}.toml")), ..plan(Path::new("/x")) }.name();
            let ends = |c: Option<char>| c.is_some_and(|c| c.is_ascii_lowercase() || c.is_ascii_digit());
            assert!(ends(name.chars().next()) && ends(name.chars().last()) && name.len() < 57, "{name}");
            assert!(name.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-'), "{name}");
        }
    }

    #[test]
    fn what_no_job_file_can_hold_is_refused() {
        let plan = plan(Path::new("/x"));
        let refusal = |plan: JobPlan, scheduler| plan.job_file(scheduler).unwrap_err();
        for scheduler in Scheduler::ALL {
            let of = |plan| refusal(plan, scheduler);
            assert_eq!(
                of(JobPlan { shards: 0, ..plan.clone() }),
                PlanError::Nothing { shards: 0, threads: 3 }
            );
            assert_eq!(
                of(JobPlan { threads: 0, ..plan.clone() }),
                PlanError::Nothing { shards: 8, threads: 0 }
            );
            assert_eq!(
                of(JobPlan { out: "runs".into(), ..plan.clone() }),
                PlanError::Relative("runs".into())
            );
            assert_eq!(
                of(JobPlan { scenario: "a\nb".into(), ..plan.clone() }),
                PlanError::ControlCharacter("a\nb".into())
            );
            let separated = "a\u{2028}b".to_owned();
            assert_eq!(
                of(JobPlan { arguments: vec![separated.clone()], ..plan.clone() }),
                PlanError::ControlCharacter(separated)
            );
        }
        let colon = JobPlan { out: "/a:b".into(), ..plan };
        assert!(colon.job_file(Scheduler::Slurm).is_ok());
        assert_eq!(refusal(colon, Scheduler::Kubernetes), PlanError::Colon("/a:b".into()));
    }
}
