#include "load.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int load_parse(struct load *load, const char *text)
{
    if (strncmp(text, "sine:", 5) == 0) {
        load->shape = SINE;
        return sscanf(text + 5, "%lf,%lf,%lf,%lf", &load->mean, &load->amplitude, &load->hertz, &load->phase) >= 3;
    }
    if (strncmp(text, "pulses:", 7) == 0) {
        load->shape = PULSES;
        return sscanf(text + 7, "%lf,%lf,%lf,%lf,%lf", &load->low, &load->high, &load->hertz, &load->duty, &load->phase)
            >= 4;
    }
    load->shape = STEPS;
    load->count = 0;
    while (load->count < 64) {
        int used = 0;
        if (sscanf(text, "%lf:%lf%n", &load->begins[load->count], &load->amperes[load->count], &used) != 2)
            return 0;
        load->count++;
        if (text[used] == '\0')
            return load->begins[0] <= 0;
        text += used + 1;
    }
    return 0;
}

static double mean_of_sine(const struct load *load, double from, double to)
{
    double turn = 2 * M_PI * load->hertz;
    double shift = 2 * M_PI * load->phase;
    if (turn == 0)
        return load->mean;
    return load->mean + load->amplitude * (cos(turn * from + shift) - cos(turn * to + shift)) / (turn * (to - from));
}

/* How many periods the pulses were on until then. */
static double periods_on(const struct load *load, double until)
{
    double turns = load->hertz * until + load->phase;
    double whole = floor(turns);
    return whole * load->duty + fmin(turns - whole, load->duty);
}

static double mean_of_pulses(const struct load *load, double from, double to)
{
    double share = (periods_on(load, to) - periods_on(load, from)) / (load->hertz * (to - from));
    return load->low + (load->high - load->low) * share;
}

double load_mean(const struct load *load, double from, double to)
{
    double charge = 0;
    if (load->shape == SINE)
        return mean_of_sine(load, from, to);
    if (load->shape == PULSES)
        return mean_of_pulses(load, from, to);
    for (int step = 0; step < load->count; step++) {
        double begin = fmax(from, load->begins[step]);
        double end = step + 1 < load->count ? fmin(to, load->begins[step + 1]) : to;
        if (end > begin)
            charge += load->amperes[step] * (end - begin);
    }
    return charge / (to - from);
}
