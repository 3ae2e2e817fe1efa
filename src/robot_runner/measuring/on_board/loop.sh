# Sample a computer's utilisation or files from inside, without Python: $form is `sh` for one with Linux's /proc, and
# `ps` for any other. It has the same requests as loop.py. This shell answers them; a second one samples.

tab=$(printf '\t')
# On Linux no tool is needed for the number of cores: each has a line in a file. nproc would tell how many this shell may
# use, which are fewer where some are isolated.
count_cores() {
    cores=0
    while read -r name _; do
        case $name in cpu[0-9]*) cores=$((cores + 1)) ;; esac
    done </proc/stat
    [ "$cores" -gt 0 ]
}

{ [ -r /proc/stat ] && count_cores; } ||
    cores=$(getconf _NPROCESSORS_ONLN 2>/dev/null || sysctl -n hw.ncpu 2>/dev/null || nproc 2>/dev/null) || cores=
page=$(getconf PAGESIZE 2>/dev/null || echo 4096)
tick=$(getconf CLK_TCK 2>/dev/null || echo 100)
sampler=
path=-
lease=0
prefix=robot-runner-samples-

# Set $now to hundredths of a second on the steady clock, and $steady to the same in seconds.
look_at_clock() {
    if [ "$form" = sh ]; then
        read -r steady _ </proc/uptime
        now=${steady%.*}${steady#*.}
    else
        steady=$(wall_clock)
    fi
}

wall_clock() {
    wall=$(date +%s.%N)
    case $wall in
        *[!0-9.]*) date +%s ;;
        *) echo "$wall" ;;
    esac
}

# Set $text to the first line of a file, with blanks for tabs, which separate fields; fail if it cannot be read.
first_line() {
    text=
    { IFS= read -r text <"$1"; } 2>/dev/null || [ -n "$text" ] || return 1
    while :; do
        case $text in
            *"$tab"*) text="${text%%"$tab"*} ${text#*"$tab"}" ;;
            *) return 0 ;;
        esac
    done
}

files_line() {
    look_at_clock
    line="f$tab$steady"
    for file in "$@"; do
        if first_line "$file"; then line="$line$tab=$text"; else line="$line$tab-"; fi
    done
}

utilisation_line() {
    look_at_clock
    line=
    while read -r name a b c d e f g h _; do
        case $name in
            cpu*) line="$line,${name#cpu}:$((a + b + c + d + e + f + g + ${h:-0})):$((d + e))" ;;
            *) break ;;
        esac
    done </proc/stat
    available=0
    while read -r name size _; do
        case $name in
            MemTotal:) total=$size ;;
            MemAvailable:) available=$size && break ;;
            MemFree: | Buffers: | Cached:) available=$((available + size)) ;;
            SwapCached:) break ;;
        esac
    done </proc/meminfo
    processes=
    if [ $# -gt 0 ]; then find_processes "$@"; fi
    line="s$tab$steady$tab${line#,}$tab$total:$available$tab${processes#,}"
}

# Put the counters of the processes that the selectors match into $processes.
find_processes() {
    if [ "$now" -ge "${next_scan:-0}" ]; then
        next_scan=$((now + 100))
        scan "$@"
    fi
    for match in $matches; do
        pid=${match#*:}
        { read -r stat <"/proc/$pid/stat"; } 2>/dev/null || continue
        add_process "${match%%:*}:$pid" ${stat##*) }
    done
}

# The words after the first are the fields of /proc/PID/stat from the third on. If a process's children are selected
# with it, then also those that lived between two samples.
add_process() {
    seconds_of $((${13} + ${14}))
    processes="$processes,$1:${21}:$seconds:$((${23} * page)):$3"
    case " $families " in
        *" ${1%%:*} "*) seconds_of $((${15} + ${16})) ;;
        *) seconds=0 ;;
    esac
    processes="$processes:$seconds"
}

# Set $seconds to ticks in seconds.
seconds_of() {
    rest=$(($1 % tick * 1000 / tick))
    while [ ${#rest} -lt 3 ]; do rest=0$rest; done
    seconds=$(($1 / tick)).$rest
}

# Put `SELECTOR'S PLACE:PID` of each process that a selector matches into $matches.
scan() {
    before=$matches
    matches=
    families=
    place=0
    for selector in "$@"; do
        value=${selector#*:}
        case $selector in
            pid:*) matches="$matches $place:$value" ;;
            name:*) scan_names ;;
            node:*) scan_nodes ;;
            subject:*)
                families="$families $place"
                scan_files environ "ROBOT_RUNNER_SUBJECT=$value" "ROBOT_RUNNER_SUBJECT=$value"
                keep_ended
                ;;
        esac
        place=$((place + 1))
    done
}

# An ended process remains, without its environment, until its parent reaps it, which has its CPU time from then on.
keep_ended() {
    for match in $before; do
        case $match in "$place":*) ;; *) continue ;; esac
        { read -r stat <"/proc/${match#*:}/stat"; } 2>/dev/null || continue
        case ${stat##*) } in Z*) matches="$matches $match" ;; esac
    done
}

# Linux keeps 15 characters of a name.
scan_names() {
    for folder in /proc/[0-9]*; do
        first_line "$folder/comm" || continue
        case $text in
            "$value" | "${value%"${value#???????????????}"}") matches="$matches $place:${folder#/proc/}" ;;
        esac
    done
}

# Each word of a command line and of an environment ends in NUL (-z: busybox searches a line up to its first NUL). The
# first grep finds itself, too, which has ended when the second one looks.
scan_files() {
    for file in $(grep -lszx -F -e "$2" -e "$3" /proc/[0-9]*/"$1"); do
        pid=${file#/proc/}
        pid=${pid%"/$1"}
        if grep -qszx -F -e "$2" -e "$3" "$file"; then
            matches="$matches $place:$pid"
        fi
    done
}

# A node's name and its namespace are separate words: `-r __node:=ear -r __ns:=/alice`. What starts a node and waits for
# it, such as `ros2 run`, has these words, too.
scan_nodes() {
    bare=${value##*/}
    space=${value%"$bare"}
    space=${space#/}
    space=${space%/}
    found=$matches
    matches=
    scan_files cmdline "__name:=$bare" "__node:=$bare"
    for match in $matches; do
        words=$({ tr '\0' '\n' <"/proc/${match#*:}/cmdline"; } 2>/dev/null)
        if printf '%s\n' "$words" | head -n 2 | grep -qE '(^|/)(ros2|sudo|timeout|gdb|xterm)$'; then continue; fi
        if [ -z "$space" ] || printf '%s\n' "$words" | grep -qx -F -e "__ns:=/$space" -e "__ns:=$space"; then
            found="$found $match"
        fi
    done
    matches=$found
}

# Sample: `keep_sampling utilisation|files WHAT...`, every $period hundredths of a second.
keep_sampling() {
    kind=$1
    shift
    look_at_clock
    due=$now
    while kill -0 $$ 2>/dev/null; do # the shell that answers still runs
        "${kind}_line" "$@"
        printf '%s\n' "$line"
        look_at_clock
        due=$((due + period))
        if [ "$due" -le "$now" ]; then due=$((now + period - (now - due) % period)); fi
        pause $((due - now))
    done
}

# Sleep for hundredths of a second.
pause() {
    rest=$(($1 % 100))
    if [ "$rest" -lt 10 ]; then rest=0$rest; fi
    sleep "$(($1 / 100)).$rest"
}

# Sample by ps: the differences of all processes' CPU time, not ps's own %cpu, which is that over a process's
# lifetime. One awk keeps the CPU time of each process at the sample before.
keep_asking_ps() {
    memory=$(getconf _PHYS_PAGES 2>/dev/null) && memory=$((memory * (page / 1024))) ||
        memory=$(($(sysctl -n hw.memsize 2>/dev/null || echo 0) / 1024))
    selectors=$(printf '%s\n' "$@")
    parent=$$
    LC_ALL=C # else some awk write and read decimal commas, and ps writes some
    export selectors cores memory period parent LC_ALL
    exec awk '
        function seconds(text, days, part, count, place, sum) {
            if (split(text, part, "-") == 2) { days = part[1]; text = part[2] }
            count = split(text, part, ":")
            for (place = 1; place <= count; place++) sum = sum * 60 + part[place]
            return days * 86400 + sum
        }
        function clock(shown, command) {
            command = "date +%s.%N"
            command | getline shown
            close(command)
            if (shown ~ /[^0-9.]/) sub(/[^0-9].*/, "", shown)
            return shown + 0
        }
        function base(word) { sub(/.*\//, "", word); return word }
        function matches(selector, words, count, value, place, space, named, within) {
            value = substr(selector, index(selector, ":") + 1)
            if (selector ~ /^pid:/) return words[1] == value
            if (selector ~ /^subject:/) return 0  # ps does not show environments
            if (selector ~ /^name:/) {
                if (base(words[4]) == value) return 1
                return base(words[4]) ~ /^(python|perl|ruby|node|sh|bash|dash)/ && base(words[5]) == value
            }
            if (base(words[4]) ~ /^(ros2|sudo|timeout|gdb|xterm)$/ || base(words[5]) ~ /^(ros2|sudo|timeout|gdb|xterm)$/)
                return 0
            space = value
            sub(/^\//, "", space)
            if (!sub(/\/[^\/]*$/, "", space)) space = ""
            value = base(value)
            for (place = 4; place <= count; place++) {
                if (words[place] == "__name:=" value || words[place] == "__node:=" value) named = 1
                if (words[place] == "__ns:=/" space || words[place] == "__ns:=" space) within = 1
            }
            return named && (space == "" || within)
        }
        BEGIN {
            asked = split(ENVIRON["selectors"], selector, "\n")
            cores = ENVIRON["cores"]; memory = ENVIRON["memory"]; period = ENVIRON["period"] / 100
            first = due = now = clock()
            for (look = 0; !system("kill -0 " ENVIRON["parent"] " 2>/dev/null"); look++) {
                resident = 0; processes = ""
                # Some ps cut lines off at 79 characters, or at COLUMNS, and with them the name of a node.
                command = "COLUMNS=32000 ps -A -o pid= -o time= -o rss= -o args="
                while ((command | getline line) > 0) {
                    count = split(line, words, " ")
                    used = seconds(words[2])
                    if (words[1] in before && used >= before[words[1]]) busy += used - before[words[1]]
                    else if (look) busy += used
                    before[words[1]] = used
                    resident += words[3]
                    for (place = 1; place <= asked; place++)
                        if (selector[place] != "" && matches(selector[place], words, count))
                            processes = processes "," (place - 1) ":" words[1] ":-:" used ":" words[3] * 1024
                }
                close(command)
                if (resident > memory) resident = memory
                total = (now - first) * cores
                printf "s\t%.3f\t:%.3f:%.3f\t", now, total, total - busy
                printf "%d:%d\t%s\n", memory, memory - resident, substr(processes, 2)
                fflush()
                due += period
                wait = due - clock()
                if (wait > 0 && system("sleep " wait)) system("sleep 1")
                now = clock()
            }
        }'
}

# Start sampling in a second shell: `begin utilisation|files RATE TOKEN WHAT...`
begin() {
    kind=$1 rate=$2 token=$3
    shift 3
    if [ "$form" = ps ] && [ "$kind" = files ]; then
        printf 'error\tthere is no /proc/uptime to time them with\n'
        return
    fi
    if [ -z "$cores" ]; then
        printf 'error\tthe number of its cores is not known: getconf, sysctl and nproc are missing\n'
        return
    fi
    shortest=100
    if [ "$form" = sh ] && sleep 0.01 2>/dev/null; then shortest=1; fi
    period=$(awk "BEGIN { printf \"%d\", 100 / $rate + 0.5 }" 2>/dev/null || echo 100)
    if [ "$period" -lt "$shortest" ]; then period=$shortest; fi
    make_file
    count_children
    spent_before=$spent
    tenths=$((1000000 / period))
    printf 'begun\t%s\t%s\t%s.%04d\n' "$path" "$cores" $((tenths / 10000)) $((tenths % 10000))
    if [ "$form" = ps ]; then set -- keep_asking_ps "$@"; else set -- keep_sampling "$kind" "$@"; fi
    if [ "$path" = - ]; then
        "$@" &
        sampler=$!
    else
        "$@" >>"$path" &
        sampler=$!
        printf 'pid\t%s\n' "$sampler" >>"$path"
    fi
}

# Set $path to a new file for the samples, or to `-` if they are to be sent at once, or no file can be made.
make_file() {
    path=-
    if [ "$token" = - ]; then return; fi
    for folder in "${TMPDIR:-/tmp}" /var/tmp "$HOME"; do
        if (set -C && : >"$folder/$prefix$token") 2>/dev/null; then
            path=$folder/$prefix$token
            return
        fi
    done
}

# Set $spent to the CPU time of this shell's children that have ended, in ticks.
count_children() {
    spent=
    if { read -r stat </proc/self/stat; } 2>/dev/null; then add_children ${stat##*) }; fi
}

add_children() {
    spent=$((${14} + ${15}))
}

# By SIGKILL, as a shell that has just started may miss any other signal.
stop_sampler() {
    if [ -n "$sampler" ]; then
        kill -9 "$sampler" 2>/dev/null
        wait "$sampler" 2>/dev/null
        sampler=
    fi
}

# End sampling, take a last sample, and send the samples that were kept: `end utilisation|files RATE TOKEN WHAT...`
end() {
    if [ -z "$sampler" ]; then
        printf 'end\t-\n'
        return
    fi
    stop_sampler
    count_children
    kind=$1
    shift 3
    if [ "$form" = sh ]; then
        "${kind}_line" "$@"
        if [ "$path" = - ]; then printf '%s\n' "$line"; else printf '%s\n' "$line" >>"$path"; fi
    fi
    if [ "$path" != - ]; then send_kept "$path"; fi
    if [ -n "$spent" ]; then
        spent=$(((spent - spent_before) * 1000 / tick))
        printf 'end\t%d.%03d\n' $((spent / 1000)) $((spent % 1000))
    else
        printf 'end\t-\n'
    fi
}

# The disk may have been full in the last line.
send_kept() {
    if [ -n "$(tail -c 1 "$1")" ]; then sed '$d' "$1"; else cat "$1"; fi | grep "^[sf]$tab"
    rm -f "$1"
}

# End the sampler that keeps its samples in a file, if it still runs.
end_holder() {
    pid=$(sed -n "s/^pid$tab//p" "$1")
    if [ -n "$pid" ] && ls -l "/proc/$pid/fd" 2>/dev/null | grep -q -F -e "-> $1"; then
        kill "$pid" && sleep 1
    fi
}

# List the files of samples of one owner's sessions.
leftovers() {
    line=paths
    for folder in "${TMPDIR:-/tmp}" /var/tmp "$HOME"; do
        for file in "$folder/$prefix$1-"*; do
            if [ -f "$file" ]; then line="$line$tab$file"; fi
        done
    done
    printf '%s\n' "$line"
}

# Remove a file of samples that nobody will fetch.
discard() {
    case ${1##*/} in
        "$prefix"*)
            if [ -r "$1" ]; then end_holder "$1"; fi
            rm -f "$1"
            ;;
    esac
    printf 'discarded\t%s\n' "$1"
}

# End a sampler that lost its connection, and send its samples.
recover() {
    if ! [ -r "$1" ]; then
        printf 'error\tthere is no %s\n' "$1"
        return
    fi
    end_holder "$1"
    send_kept "$1"
    printf 'end\t-\n'
}

# Set $text to a command line, with \001 for the NUL behind each word, which a shell cannot keep; fail if it is empty.
command_line() {
    text=$({ tr '\000\t\n' '\001  ' <"$1"; } 2>/dev/null)
    [ -n "$text" ]
}

read_files() {
    line=lines
    for file in "$@"; do
        case $file in /proc/*/cmdline) look=command_line ;; *) look=first_line ;; esac
        if "$look" "$file"; then line="$line$tab=$text"; else line="$line$tab-"; fi
    done
    printf '%s\n' "$line"
}

list_files() {
    line=paths
    for file in $1; do
        if [ -e "$file" ]; then line="$line$tab$file"; fi
    done
    printf '%s\n' "$line"
}

trap stop_sampler EXIT
trap '' HUP # a cut connection is noticed by the end of the input
while IFS= read -r asked; do
    set -f
    IFS=$tab
    set -- $asked
    unset IFS
    set +f
    case $1 in
        clock)
            look_at_clock
            printf 'clock\t%s\t%s\t%s\n' "$2" "$steady" "$(wall_clock)"
            ;;
        utilisation | files)
            about=$asked
            begin "$@"
            ;;
        stop)
            set -f
            IFS=$tab
            set -- $about
            unset IFS
            set +f
            end "$@"
            ;;
        read) shift && read_files "$@" ;;
        list) list_files "$2" ;;
        recover) recover "$2" ;;
        leftovers) leftovers "$2" ;;
        discard) discard "$2" ;;
        lease) lease=$2 ;;
        leave) lease=0 ;;
        *) printf 'error\tasked for\t%s\n' "$1" ;;
    esac
done

# The connection was cut: go on for the lease, or until another session fetches the samples.
if [ -n "$sampler" ] && [ "$path" != - ]; then
    while [ "$lease" -gt 0 ] && [ -e "$path" ]; do
        sleep 1
        lease=$((lease - 1))
    done
fi
