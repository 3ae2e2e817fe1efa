# Print the forms in which this computer can be sampled, read the chosen one and its program, and execute that.
umask 077
forms=
if [ -r /proc/stat ] && [ -r /proc/meminfo ] && [ -r /proc/uptime ]; then
    if python3 -I -S -c 'import sys; sys.exit(sys.version_info < (3, 6))' 2>/dev/null; then
        forms=python3
    fi
    forms="$forms sh"
fi
if ps -A -o pid= -o time= -o rss= -o args= >/dev/null 2>&1 && awk 'BEGIN { exit 0 }' 2>/dev/null; then
    forms="$forms ps"
fi
# In a line of its own, as what a login writes (the title of a terminal, say) may not end in a line feed.
printf '\nrobot-runner\t1\t%s\n' "$forms"
read -r form || exit 0
program=
newline='
'
while IFS= read -r line && [ "$line" != '#end' ]; do
    program="$program$line$newline"
done
case $form in
    python3) exec python3 -I -S -u -c "$program" ;;
    *) eval "$program" ;;
esac
