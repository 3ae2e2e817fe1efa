/* The power meter's board, executed: the firmware on an ATmega328P in simavr, with an INA219 that sees known currents,
   an SD card in a file, and the UART on a pseudo-terminal.

   It prints the name of the pseudo-terminal, waits until somebody opens it (which resets the board, as on a real one),
   and goes on until it is closed, or for the time that was given, at the end of which the cable is pulled out. Last it
   prints figures of its own as JSON.

   Time goes by as fast as the simulation can, or at a pace, or only as far as whoever has the clock's file mapped lets
   it: four doubles, the time, up to when it may go on, both in s, how many bytes were taken from the line, where that is
   not negative time stands still until what was handed over has been taken, and how often the port was closed. */

#define _GNU_SOURCE
#include <fcntl.h>
#include <simavr/avr_ioport.h>
#include <simavr/sim_avr.h>
#include <simavr/sim_elf.h>
#include <simavr/sim_io.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "card.h"
#include "line.h"
#include "load.h"
#include "sensor.h"

#define HERTZ 16000000
#define BEAT_US 1000
#define MARK 4 /* PD4 */
#define LAMP 5 /* PD5 */
#define MOMENTS 16
#define SENSORS 4
#define FIRST_ADDRESS 0x40
#define PATIENCE 60 /* real seconds until the port is opened */

static avr_t *avr;
static struct load load;
static struct sensor sensors[SENSORS];
static int sensor_count = 1;
static struct card card;
static struct line line;

static double skew; /* how much slower than nominal the resonator is */
static double seconds; /* how long to go on; 0: until the port is closed */
static double pace; /* seconds of the board in a real second; 0: as many as it can */
static int openings = 1;
static volatile double *shared; /* as said above; may be null */
static double marks[MOMENTS], away[MOMENTS], faint[MOMENTS], stuck[MOMENTS]; /* s; 0 ends each */
static avr_cycle_count_t before_reset; /* cycles that a reset took from the counter */
static double began_real;
static int lamp;
static unsigned stack; /* bytes of it that were used at most */

/* The true time since power-on, s. */
static double now(void)
{
    return (double) (before_reset + avr->cycle) / HERTZ * (1 + skew);
}

static double real_now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double) time.tv_sec + 1e-9 * (double) time.tv_nsec;
}

/* How many of the moments have come. */
static int count_passed(const double *moments)
{
    int count = 0;
    while (count < MOMENTS && moments[count] > 0 && moments[count] <= now())
        count++;
    return count;
}

static void keep_step(void)
{
    if (!shared)
        return;
    shared[0] = now();
    while (shared[0] >= shared[1] && !line.is_closed) {
        usleep(100);
        line_look(&line);
    }
}

static void keep_pace(void)
{
    double ahead = pace > 0 ? now() / pace - (real_now() - began_real) : 0;
    if (ahead > 1e-3)
        usleep((useconds_t) (ahead * 1e6));
}

static avr_cycle_count_t beat(avr_t *board, avr_cycle_count_t when, void *param)
{
    static int fainted;
    (void) param;
    sensors[0].is_away = count_passed(away) % 2;
    sensors[0].is_stuck = count_passed(stuck) % 2;
    avr_raise_irq(avr_io_getirq(board, AVR_IOCTL_IOPORT_GETIRQ('D'), MARK), count_passed(marks) % 2 == 0);
    if (count_passed(faint) > fainted) {
        fainted++;
        sensor_reset(&sensors[0]);
    }
    line_serve(&line);
    keep_step();
    keep_pace();
    return when + HERTZ / 1000000 * BEAT_US;
}

static void do_not_sleep(avr_t *board, avr_cycle_count_t cycles)
{
    (void) board;
    (void) cycles;
}

static void be_silent(avr_t *board, const int level, const char *format, va_list arguments)
{
    (void) board;
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, arguments);
}

static void see_lamp(struct avr_irq_t *irq, uint32_t level, void *param)
{
    (void) irq;
    (void) param;
    lamp = (int) level;
}

static int make_board(const char *path)
{
    elf_firmware_t firmware;
    memset(&firmware, 0, sizeof firmware);
    avr_global_logger_set(be_silent);
    if (elf_read_firmware(path, &firmware) || !(avr = avr_make_mcu_by_name("atmega328p")))
        return 0;
    avr_init(avr);
    avr_load_firmware(avr, &firmware);
    avr->frequency = HERTZ;
    avr->sleep = do_not_sleep;
    card.now = line.now = now;
    for (int at = 0; at < sensor_count; at++) {
        sensors[at].load = &load;
        sensors[at].now = now;
        sensor_attach(&sensors[at], avr);
    }
    line_attach(&line, avr);
    if (card.image)
        card_attach(&card, avr);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ('D'), LAMP), see_lamp, NULL);
    return 1;
}

static void see_stack(void)
{
    unsigned top = avr->data[R_SPL] | avr->data[R_SPH] << 8;
    if (avr->ramend - top > stack && top > 0x100)
        stack = avr->ramend - top;
}

/* What the firmware has set the line and the bus to (ATmega328P data sheet, sections 19.3 and 21.5.2). */
static double baud(void)
{
    unsigned divisor = (avr->data[0xC4] | avr->data[0xC5] << 8) + 1;
    return (double) HERTZ / (avr->data[0xC0] & 2 ? 8 : 16) / divisor;
}

static double bus_hertz(void)
{
    return (double) HERTZ / (16 + 2 * avr->data[0xB8] * (1 << 2 * (avr->data[0xB9] & 3)));
}

/* Execute until the port is closed or the time is over; return 0 if the firmware broke down. */
static int execute(void)
{
    /* As cycles: the loop is passed for each instruction. */
    double last = seconds == 0 ? 0x1p62 : seconds / (1 + skew) * HERTZ - (double) before_reset;
    avr_cycle_count_t end = last > 0 ? (avr_cycle_count_t) last : 0;
    avr_cycle_timer_register_usec(avr, BEAT_US, beat, NULL);
    while (!line.is_closed && avr->cycle < end) {
        int state = avr_run(avr);
        see_stack();
        if (state == cpu_Done || state == cpu_Crashed)
            return 0;
    }
    return 1;
}

static void press_reset(void)
{
    before_reset += avr->cycle;
    avr_reset(avr);
    avr->cycle = 0;
}

static void tell(void)
{
    printf("{\"seconds\": %.6f, \"bytes\": %llu, \"corrupted\": %llu, \"lamp\": %d, \"stack\": %u, \"baud\": %.1f, "
           "\"bus_hertz\": %.1f}\n",
        now(), (unsigned long long) line.sent, (unsigned long long) line.corrupted, lamp, stack, baud(), bus_hertz());
}

static void read_moments(double *moments, const char *text)
{
    for (int at = 0; at < MOMENTS && *text; at++) {
        char *rest;
        moments[at] = strtod(text, &rest);
        text = *rest == ',' ? rest + 1 : rest + strlen(rest);
    }
}

static volatile double *map_clock(const char *path)
{
    int file = open(path, O_RDWR);
    void *page = MAP_FAILED;
    if (file >= 0)
        page = mmap(NULL, 4 * sizeof(double), PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    return page == MAP_FAILED ? NULL : page;
}

static const char *firmware_path;

static void for_all_sensors(size_t member, double number)
{
    for (int at = 0; at < SENSORS; at++)
        *(double *) ((char *) &sensors[at] + member) = number;
}

static int set(const char *name, const char *text)
{
    if (strcmp(name, "firmware") == 0)
        firmware_path = text;
    else if (strcmp(name, "load") == 0)
        return load_parse(&load, text);
    else if (strcmp(name, "volts") == 0)
        load.volts = atof(text);
    else if (strcmp(name, "shunt") == 0)
        for_all_sensors(offsetof(struct sensor, shunt), atof(text));
    else if (strcmp(name, "slowness") == 0)
        for_all_sensors(offsetof(struct sensor, slowness), atof(text));
    else if (strcmp(name, "noise") == 0)
        for_all_sensors(offsetof(struct sensor, noise), atof(text));
    else if (strcmp(name, "sensors") == 0)
        return (sensor_count = atoi(text)) >= 1 && sensor_count <= SENSORS;
    else if (strcmp(name, "seconds") == 0)
        seconds = atof(text);
    else if (strcmp(name, "pace") == 0)
        pace = atof(text);
    else if (strcmp(name, "skew") == 0)
        skew = atof(text);
    else if (strcmp(name, "openings") == 0)
        openings = atoi(text);
    else if (strcmp(name, "corrupt") == 0)
        line.corrupt = atof(text);
    else if (strcmp(name, "seed") == 0)
        line.seed = strtoull(text, NULL, 10);
    else if (strcmp(name, "truth") == 0)
        return (line.truth = fopen(text, "wb")) != NULL;
    else if (strcmp(name, "clock") == 0)
        return (shared = map_clock(text)) != NULL;
    else if (strcmp(name, "card") == 0)
        return (card.image = fopen(text, "r+b")) != NULL;
    else if (strcmp(name, "card-busy") == 0)
        return sscanf(text, "%lf,%d", &card.busy_s, &card.busy_every) == 2;
    else if (strcmp(name, "marks") == 0)
        read_moments(marks, text);
    else if (strcmp(name, "away") == 0)
        read_moments(away, text);
    else if (strcmp(name, "faint") == 0)
        read_moments(faint, text);
    else if (strcmp(name, "stuck") == 0)
        read_moments(stuck, text);
    else
        return 0;
    return 1;
}

static int understand(int count, char **words)
{
    load_parse(&load, "0:0");
    load.volts = 12;
    /* The data sheet gives no figure for the noise; one step is the least that its converter can show. Further sensors
       measure a half, a third, a quarter of the load. */
    for (int at = 0; at < SENSORS; at++)
        sensors[at] = (struct sensor){.address = (uint8_t) (FIRST_ADDRESS + at), .share = 1.0 / (at + 1), .shunt = 0.1,
            .noise = 10e-6, .seed = (uint64_t) at};
    card.busy_every = 1;
    card.busy_s = 2e-3;
    for (int at = 1; at < count; at++) {
        char *value = strchr(words[at], '=');
        if (strncmp(words[at], "--", 2) != 0 || value == NULL)
            return 0;
        *value = '\0';
        if (!set(words[at] + 2, value + 1)) {
            fprintf(stderr, "board: cannot use %s=%s\n", words[at], value + 1);
            return 0;
        }
    }
    return firmware_path != NULL;
}

int main(int count, char **words)
{
    int is_alive = 1;
    if (!understand(count, words) || !make_board(firmware_path) || !line_open(&line)) {
        fprintf(stderr, "board: usage: board --firmware=FILE [--load=0:0.7,15:0.95 | --load=sine:0.8,0.1,3] ...\n");
        return 2;
    }
    line.taken = shared ? shared + 2 : NULL;
    while (openings-- > 0 && is_alive && line_wait(&line, PATIENCE)) {
        began_real = real_now() - (pace > 0 ? now() / pace : 0);
        is_alive = execute();
        if (shared)
            shared[3]++;
        if (openings == 0)
            tell();
        press_reset();
    }
    if (line.truth)
        fclose(line.truth);
    return is_alive ? 0 : 1;
}
