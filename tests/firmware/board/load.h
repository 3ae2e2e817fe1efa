/* What the robot draws: a current that is known at every moment, so that its energy is. */
#ifndef LOAD_H
#define LOAD_H

struct load {
    double volts; /* behind the shunt */
    enum { STEPS, SINE, PULSES } shape;
    int count; /* of steps; each lasts until the next one begins, the last for ever */
    double begins[64]; /* s */
    double amperes[64];
    double mean, amplitude; /* of the sine: mean + amplitude * sin(2 pi (hertz t + phase)) */
    double low, high, duty; /* of the pulses: high while the fraction of (hertz t + phase) is below duty, else low */
    double hertz, phase; /* of both; the phase in turns */
};

/* Understand `0:0.7,15:0.95,40:0.8`, `sine:0.8,0.1,3[,phase]` or `pulses:low,high,hertz,duty[,phase]`; return 0 if it
   is none of them. */
int load_parse(struct load *load, const char *text);

/* The mean current between two moments, s, in amperes. */
double load_mean(const struct load *load, double from, double to);

#endif
