#!/usr/bin/env bash
# A campaign on a real Slurm: two nodes on this machine, of which one is killed, as are tasks; shards are corrupted, foreign and overlapping.
# Nothing may be lost or counted twice, each fault must be named, and the merge must be the bytes of one machine.
#   tests/tools/slurm_campaign.sh PATH_OF_CALIBRIG [TRIALS]
# Installs Slurm with apt where it is absent. Where that fails, or it does not start, prints SKIPPED and the reason.
set -euo pipefail
cd "$(dirname "$0")/../.."

calibrig="$(realpath "$1")" trials="${2:-2000}" shards=8
# Seconds for all but the installation.
limit=170
PATH="$PATH:/usr/sbin:/sbin"

# With a space: Slurm and the shells between must pass it on.
work="$(mktemp -d)"
out="$work/a campaign" one="$work/one machine"
unset "${!SLURM_@}" "${!SBATCH_@}" "${!SQUEUE_@}"
export SLURM_CONF="$work/slurm.conf"
# What is started here, and all that it starts, is known by this variable, wherever daemons put themselves.
export CALIBRIG_SLURM_TEST="$work"

# By the folder, too: slurmstepd writes its title over its environment.
ours() {
    (
        export -n CALIBRIG_SLURM_TEST
        { grep -lzxsF "CALIBRIG_SLURM_TEST=$work" /proc/[0-9]*/environ; find /proc/[0-9]*/cwd -maxdepth 0 -lname "$work/*" 2>/dev/null; } | cut -d/ -f3 | sort -u
    ) || true
}
clean_up() {
    local status=$? left
    trap - EXIT
    # Daemons may be starting others.
    for _ in {1..20}; do
        left="$(ours)"
        [ -n "$left" ] || break
        # shellcheck disable=SC2086
        kill -KILL $left 2>/dev/null || true
        sleep 0.2
    done
    rm -rf "$work"
    exit "$status"
}
trap clean_up EXIT
trap 'exit 143' INT TERM HUP

say() { printf '%4d s  %s\n' $((SECONDS - started)) "$*"; }
skip() {
    echo "SKIPPED: A CAMPAIGN ON A REAL SLURM: $1"
    exit 0
}
fail() {
    echo "FAILED: $1"
    squeue -r -t all 2>/dev/null || true
    tail -n 15 "$work"/*.log "$work"/n?/*.log "$out"/logs/*.log 2>/dev/null || true
    exit 1
}
# Waits for what the first argument says: tries the rest, a command, until it succeeds.
await() {
    until "${@:2}"; do
        [ $((SECONDS - started)) -lt $limit ] || fail "no end of the time of $limit s: $1"
        sleep 0.2
    done
}

started=$SECONDS
installed() { local name; for name in munged slurmctld slurmd sbatch squeue scontrol sinfo; do command -v $name >/dev/null || return 1; done; }
if ! installed; then
    [ "$(id -u)" = 0 ] || skip "slurm-wlm is not installed, and only root installs it"
    command -v apt-get >/dev/null || skip "slurm-wlm is not installed, and there is no apt"
    export DEBIAN_FRONTEND=noninteractive
    { timeout 60 apt-get update -qq && timeout 120 apt-get install -y -qq --no-install-recommends slurm-wlm munge; } >"$work/apt.log" 2>&1 ||
        skip "apt could not install slurm-wlm: $(tail -n1 "$work/apt.log")"
    say "installed"
fi
started=$SECONDS

# --- Two nodes of one processor, on this machine alone -----------------------------------------------------------------------------
free_port() {
    local port
    for _ in {1..50}; do
        port=$((20000 + RANDOM % 12000))
        (exec 3<>"/dev/tcp/127.0.0.1/$port") 2>/dev/null || { echo $port; return; }
    done
}
host="$(hostname -s)" user="$(id -un)"
mkdir -p "$work"/{munge,socket,state,n0,n1}
chmod 755 "$work" "$work/socket"
chmod 700 "$work/munge"
(umask 077 && head -c 64 /dev/urandom >"$work/munge/key")
# A requeued task waits until its old credential is no longer good: 120 s, unless that is said here.
cat >"$SLURM_CONF" <<END
ClusterName=calibrig
SlurmctldHost=$host(127.0.0.1)
SlurmctldPort=$(free_port)
SlurmUser=$user
SlurmdUser=$user
AuthType=auth/munge
AuthInfo=socket=$work/socket/munge,cred_expire=5
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SchedulerParameters=sched_interval=1,batch_sched_delay=0,bf_interval=1
ReturnToService=2
SlurmdTimeout=5
SlurmctldTimeout=5
MessageTimeout=2
TCPTimeout=1
KillWait=5
MinJobAge=600
SlurmctldPidFile=$work/slurmctld.pid
SlurmdPidFile=$work/%n/slurmd.pid
SlurmdSpoolDir=$work/%n/spool
StateSaveLocation=$work/state
SlurmctldLogFile=$work/slurmctld.log
SlurmdLogFile=$work/%n/slurmd.log
NodeName=n0 NodeHostname=$host NodeAddr=127.0.0.1 Port=$(free_port) CPUs=1 RealMemory=1500
NodeName=n1 NodeHostname=$host NodeAddr=127.0.0.1 Port=$(free_port) CPUs=1 RealMemory=1500
PartitionName=main Nodes=n0,n1 Default=YES State=UP
END
start() {
    timeout 20 munged --key-file="$work/munge/key" --socket="$work/socket/munge" --pid-file="$work/munge/pid" --log-file="$work/munge.log" \
        --seed-file="$work/munge/seed" --num-threads=1 &&
        timeout 20 slurmctld && timeout 20 slurmd -N n0 && timeout 20 slurmd -N n1
}
idle() { [ "$(sinfo -h -N -o %T 2>/dev/null | sort | uniq -c | xargs)" = "2 idle" ]; }
start >"$work/start.log" 2>&1 || skip "it does not start: $(cat "$work"/{start,munge,slurmctld}.log "$work"/n?/slurmd.log 2>/dev/null | grep -iE 'error|fatal' | tail -n1)"
for _ in {1..100}; do idle && break; sleep 0.2; done
idle || skip "its nodes do not come up: $(grep -hi error "$work/slurmctld.log" "$work"/n?/slurmd.log | tail -n1)"
say "$(sbatch --version), two nodes"

# --- The campaign ----------------------------------------------------------------------------------------------------------------
campaign=("$calibrig" montecarlo scenarios/matched.toml --plant analytic --trials "$trials" --threads 1)
"${campaign[@]}" --plan slurm --shards $shards --out "$out" >"$work/plan.log" 2>&1 || { cat "$work/plan.log"; fail "no plan"; }
job="$(sbatch --parsable "$out/slurm.sh")"
say "submitted $shards shards of $trials trials: job $job"

# The task of a node: its process, and the number of its shard.
task_of() { (export -n CALIBRIG_SLURM_TEST; grep -lzxsF "SLURMD_NODENAME=$1" $(ours | sed 's|.*|/proc/&/environ|') | cut -d/ -f3 | head -n1 || true); }
variable() { tr '\0' '\n' <"/proc/$1/environ" | sed -n "s/^$2=//p"; }
runs() { task="$(task_of "$1")"; [ -n "$task" ] && grep -qsa montecarlo "/proc/$task/cmdline" && number="$(variable "$task" SLURM_ARRAY_TASK_ID 2>/dev/null)"; }
parent() { sed -n 's/^PPid:\t//p' "/proc/$1/status"; }

done_are() { [ "$(find "$out/shards" -name '*.parquet' 2>/dev/null | wc -l)" -ge "$1" ]; }
await "two shards" done_are 2
await "a task on n0" runs n0
# In the middle of its trials.
sleep 1
await "a task on n0" runs n0
lost=$number
kill -KILL "$(cat "$work/n0/slurmd.pid")" "$(parent "$task")" "$task"
lost_at=$SECONDS
say "killed node n0 with the task of shard $lost"
await "a task on n1" runs n1
killed=$number
kill -KILL "$task"
say "killed the task of shard $killed"

# What the campaign is compared with, and two shards that are none of it. Beside Slurm, which has one node left.
(
    "${campaign[@]}" --out "$one"
    "${campaign[@]}" --seed 999 --shard 2/$shards --out "$work/foreign"
    "${campaign[@]}" --shard 5/16 --out "$work/overlapping"
) >"$work/beside.log" 2>&1 &
beside=$!

another() { runs n1 && [ "$number" != "$killed" ] && [ "$number" != "$lost" ]; }
await "another task on n1" another
sleep 1
await "another task on n1" another
cancelled=$number
scancel "${job}_$cancelled"
say "cancelled the task of shard $cancelled"

field() { scontrol -o show job "${job}_$1" | grep -o " $2=[^ ]*" | cut -d= -f2; }
requeued() { [ "$(field "$lost" Restarts)" = 1 ]; }
await "the lost task is queued again" requeued
say "Slurm queued the task of the lost node again, after $((SECONDS - lost_at)) s"
again() { [ "$(field "$lost" JobState)" != PENDING ]; }
await "the lost task runs again" again
say "it runs again, after $((SECONDS - lost_at)) s"
ended() { [ -z "$(squeue -h -j "$1" 2>/dev/null)" ]; }
await "the array ends" ended "$job"
say "the array ended: lost $lost $(field "$lost" JobState), killed $killed $(field "$killed" JobState), cancelled $cancelled $(field "$cancelled" JobState)"
[ "$(field "$lost" JobState)" = COMPLETED ] || fail "the task of the lost node was not run again"

# --- What is missing, and what must not be merged -----------------------------------------------------------------------------------
# Runs a command and keeps what it says and its exit code.
run() { code=0; said="$("$@" 2>"$work/errors")" || code=$?; }
numbers() { local part; for part in ${1//,/ }; do seq "${part%-*}" "${part#*-}"; done | xargs; }
sorted() { printf '%s\n' "$@" | sort -nu | xargs; }
is_missing() {
    run "$calibrig" missing "$out"
    [ "$(numbers "$said")" = "$(sorted "$@")" ] || { cat "$work/errors"; fail "missing are $(sorted "$@"), and it printed '$said'"; }
    [ $code = 3 ] || fail "exit code $code of missing, not 3"
}
# The merge ends with an exit code and leaves no table.
refused() {
    run "$calibrig" merge "$out"
    [ $code = "$1" ] || { cat "$work/errors"; fail "exit code $code of merge, not $1"; }
    [ ! -e "$out/trials.parquet" ] || fail "the merge left a table"
}
names() { for name; do grep -qF "$name" "$work/errors" || { cat "$work/errors"; fail "$name is not named"; }; done; }
# The file of a shard of this campaign: its name may go on.
own="$(find "$out/shards" -name '*.parquet' -printf '%f\n' | cut -c-12 | sort -u)"
shard() { find "$out/shards" -name "$own-$(printf %06d "$1")-of-$(printf %06d $shards)*.parquet"; }

is_missing "$killed" "$cancelled"
refused 3
sed 's/^/        /' "$work/errors"
say "missing are $(sorted "$killed" "$cancelled"), and the merge is refused"

wait $beside || { cat "$work/beside.log"; fail "a run beside Slurm"; }
say "run on one machine"
for ((broken = 0; broken < shards; broken++)); do case $broken in "$killed" | "$cancelled" | "$lost") ;; *) break ;; esac; done
file="$(shard $broken)" middle=$(($(stat -c %s "$(shard $broken)") / 2))
byte="$(od -An -tu1 -j $middle -N 1 "$file")"
# shellcheck disable=SC2059
printf "\\$(printf %o $(((byte + 1) % 256)))" | dd of="$file" bs=1 seek=$middle conv=notrunc status=none
foreign="$(find "$work/foreign/shards" -name '*.parquet')" overlapping="$(find "$work/overlapping/shards" -name '*.parquet')"
cp "$foreign" "$overlapping" "$out/shards/"
# Under the name of one that is missing, too.
foreign="$(basename "$foreign")" overlapping="$(basename "$overlapping")" broken_file="$(basename "$file")"
impostor="$own-$(printf %06d "$killed")${foreign#*-??????}"
cp "$out/shards/$foreign" "$out/shards/$impostor"

is_missing "$killed" "$cancelled" "$broken"
names "$broken_file" "$foreign" "$overlapping" "$impostor"
sed 's/^/        /' "$work/errors"
say "named: one corrupted, one foreign, one overlapping, one foreign under the name of a missing one"
run "$calibrig" merge "$out"
[ $code != 0 ] && [ ! -e "$out/trials.parquet" ] || fail "exit code $code of merge, where shards are missing and others must not be merged"

# --- Mended ------------------------------------------------------------------------------------------------------------------------
sound() { for ((i = 0; i < shards; i++)); do case $i in "$killed" | "$cancelled" | "$broken") ;; *) stat -c '%n %i %Y' "$(shard "$i")" || return 1 ;; esac; done; }
before="$(sound)"
timeout 20 slurmd -N n0 >>"$work/start.log" 2>&1 || fail "node n0 does not start again"
await "node n0 is back" idle
# `missing` ends with 3, and says what it says in words; its numbers are what counts.
job="$(sbatch --parsable --array="$("$calibrig" missing "$out" 2>/dev/null)" "$out/slurm.sh")"
await "the second array ends" ended "$job"
grep -q "trials are done already" "$out/logs/slurm-${job}_$cancelled.log" || fail "the trials that the cancelled task had done are done again"
say "submitted again what was missing"
run "$calibrig" missing "$out"
[ -z "$said" ] || { cat "$work/errors"; fail "still missing: $said"; }
[ "$before" = "$(sound)" ] || fail "shards that were sound were written again"
refused 1
names "$foreign" "$overlapping"
sed 's/^/        /' "$work/errors"
say "nothing is missing, and the merge is refused for what is too much"
rm -f "$out/shards/$foreign" "$out/shards/$overlapping"
# Computing the shard that it stood for may have put it right.
grep -qF "$impostor" "$work/errors" && rm "$out/shards/$impostor"
run "$calibrig" missing "$out"
[ "$code$said" = 0 ] || { cat "$work/errors"; fail "exit code $code of missing, where all are there; it printed '$said'"; }
run "$calibrig" merge "$out"
[ $code = 0 ] || { cat "$work/errors"; fail "exit code $code of merge"; }
cmp "$out/trials.parquet" "$one/trials.parquet" || fail "the table of the shards is not that of one machine"
say "merged: $(stat -c %s "$out/trials.parquet") bytes, those of one machine"
