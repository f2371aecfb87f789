#include "expected.h"

#include <math.h>
#include <string.h>

#include "rays.h"

/* Priors, sigma, for the orders 0, 2, 3 and 4 of an outline. */
static const double UNSEEN[] = {0.30, 0.12, 0.01, 0.03};     /* of the radius, any marker: half a turn is no change */
static const double SLOPE[] = {0.02, 0.02, 0.002, 0.005};    /* by which it changes a px of the way ... */
static const double BENDS[] = {0.005, 0.005, 0.0005, 0.001}; /* ... and by how much that does in a diameter */
static const double STRETCH[] = {0.0, 0.02, 0.0, 0.01};      /* by which motion blurs it, of the way in a frame */
#define AGES           5e-4  /* prior: of the radius, from frame to frame, where it is */
#define BENEATH_PX     0.03  /* prior: by which tissue beneath the rim, and compression, change a term */
#define SMALLEST_PX    1.0   /* limit: of a radius */
#define UNSEEN_SCATTER 0.015 /* prior: of the radius: of edges */
#define UNSEEN_STEP    0.5   /* prior: of their variance: between a picture's without compression and MJPEG's ... */
#define UNSEEN_LARGE   2.5   /* ... as this */
#define MOST_ALIKE     0.98  /* tolerance: of a correlation */
#define SHADED         0.5   /* prior: that a marker is lit from one side */
#define SHIFTED        3.0   /* prior: by how much more than expected what is in front changes the outline */
#define FREEDOM        3.0   /* equation: numbers that say what is in front: from which side, how deep, how wide */
#define LEARNS         0.05  /* prior: a frame: how soon it is known how little the outline wanders ... */
#define LARGEST        4.0   /* tolerance: ... which no frame contradicts by more than so many variances */
#define STEADIEST      0.03  /* prior: share of the wandering that is never ruled out */
#define UNSURE         0.1   /* prior: of the radius, times the share that is hidden: what is in front bends the rest */
#define STEADY         0.1   /* prior: least weight of a frame's noise beside that of the frames before */

static int order(int term) {
    return (term + 1) / 2;
}

void marker_expect(double diameter, marker_expected_t *out) {
    const double radius = fmax(0.5 * diameter, SMALLEST_PX);
    memset(out, 0, sizeof *out);
    out->shape[0].value = radius;
    for (int k = 0; k < MARKER_SHAPE; k++) {
        const double unseen = UNSEEN[order(k)] * radius, slope = SLOPE[order(k)];
        out->shape[k].covariance[0][0] = unseen * unseen;
        out->steady[k] = 1.0;
        out->shape[k].covariance[1][1] = out->shape[k].covariance[2][2] = slope * slope;
    }
    const double edge = UNSEEN_SCATTER * radius * UNSEEN_SCATTER * radius;
    out->noise = (marker_noise_t){1.0, edge, UNSEEN_STEP * edge, UNSEEN_LARGE * edge};
    out->shaded = SHADED;
}

void expected_at(const marker_expected_t *before, double u, double v, marker_expected_t *out) {
    *out = *before;
    out->u = u;
    out->v = v;
    out->seen = 1;
    if (!before->seen) {
        return;
    }
    const double step[] = {u - before->u, v - before->v}, way = hypot(step[0], step[1]);
    const double diameter = 2.0 * before->shape[0].value;
    for (int k = 0; k < MARKER_SHAPE; k++) {
        marker_term_t *term = &out->shape[k];
        double (*p)[3] = term->covariance;
        term->value += term->by_u * step[0] + term->by_v * step[1];
        for (int pass = 0; pass < 2; pass++) { /* rows, then columns */
            for (int i = 0; i < 3; i++) {
                const double moved = step[0] * (pass ? p[i][1] : p[1][i]) + step[1] * (pass ? p[i][2] : p[2][i]);
                *(pass ? &p[i][0] : &p[0][i]) += moved;
            }
        }
        const double bends = before->steady[k] * BENDS[order(k)] * BENDS[order(k)] * way / diameter;
        const double ages = AGES * 0.5 * diameter;
        for (int i = 0; i < 2; i++) { /* a slope that wanders all along the step: its integral's moments */
            p[1 + i][1 + i] += bends;
            p[0][1 + i] += 0.5 * bends * step[i];
            p[1 + i][0] += 0.5 * bends * step[i];
        }
        p[0][0] += bends * way * way / 3.0 + ages * ages;
        out->stretched[k] = STRETCH[order(k)] * way;
    }
    out->shape[0].value = fmax(out->shape[0].value, SMALLEST_PX);
}

/* px2: variance of a term from frame to frame. */
static double this_frame(const marker_expected_t *expected, int term) {
    return BENEATH_PX * BENEATH_PX + expected->stretched[term] * expected->stretched[term];
}

double expected_variance(const marker_expected_t *expected, int term) {
    return expected->shape[term].covariance[0][0] + this_frame(expected, term);
}

double expected_scatter(const marker_noise_t *noise, double square, double count) {
    return (AS_MANY * noise->all + square) / (AS_MANY + fmax(count, 0.0));
}

double expected_together(const marker_noise_t *noise) {
    return fmax(noise->large / noise->all, 1.0);
}

double expected_alike(const marker_noise_t *noise) {
    return fmin(fmax(1.0 - noise->step / noise->all, 0.0), MOST_ALIKE);
}

/* px2: variance of a term of the outline by the noise of its edges. */
static double noise(const marker_expected_t *expected, int term, double scatter, int kept) {
    return (term == 0 ? 1.0 : 2.0) * expected_together(&expected->noise) * scatter * scatter / kept;
}

double expected_hidden(const marker_expected_t *expected, const double shape[MARKER_SHAPE], double scatter, int kept,
                       int count) {
    double misfit = 0.0;
    for (int k = 0; k < MARKER_SHAPE; k++) {
        const double away = shape[k] - expected->shape[k].value;
        misfit += away * away / (expected_variance(expected, k) + noise(expected, k, scatter, kept));
    }
    const double together = expected_together(&expected->noise), n = count / together,
                 strays = (count - kept) / together;
    const double wide = 1.0 + SHIFTED * SHIFTED;
    const double share = lgamma(strays + 1.0) + lgamma(n - strays + 1.0) - lgamma(n + 2.0); /* any is as likely */
    return log(HIDDEN / (1.0 - HIDDEN)) + 0.5 * misfit * (1.0 - 1.0 / wide) - 0.5 * FREEDOM * log(wide) + share -
           strays * log(STRAY) - (n - strays) * log(1.0 - STRAY);
}

/* Kalman's update of a term with `value`, of variance `noise`. */
static void update(marker_term_t *term, double value, double variance) {
    double (*p)[3] = term->covariance, gain[3];
    const double innovation = value - term->value, first[] = {p[0][0], p[0][1], p[0][2]};
    for (int i = 0; i < 3; i++) {
        gain[i] = first[i] / (first[0] + variance);
    }
    term->value += gain[0] * innovation;
    term->by_u += gain[1] * innovation;
    term->by_v += gain[2] * innovation;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            p[i][j] -= gain[i] * first[j];
        }
    }
}

void expected_learn(marker_expected_t *expected, const double shape[MARKER_SHAPE], double scatter, int kept,
                    double hidden) {
    const double wide = SHIFTED * SHIFTED / (1.0 + exp(-hidden)); /* the mixture that is weighed in expected_hidden */
    for (int k = 0; k < MARKER_SHAPE; k++) {
        const double seen = noise(expected, k, scatter, kept);
        const double told = seen + this_frame(expected, k) + wide * (expected_variance(expected, k) + seen);
        const double away = shape[k] - expected->shape[k].value;
        const double unusual = away * away / (expected->shape[k].covariance[0][0] + told);
        expected->steady[k] *= exp(LEARNS * (fmin(unusual, LARGEST) - 1.0));
        expected->steady[k] = fmin(fmax(expected->steady[k], STEADIEST), 1.0);
        update(&expected->shape[k], shape[k], told);
    }
}

void expected_learn_noise(marker_expected_t *expected, const marker_noise_t *seen, double known) {
    marker_noise_t *noise = &expected->noise;
    const double gain = fmax(known / (noise->frames + known), STEADY * known);
    noise->frames += known;
    noise->all += gain * (seen->all - noise->all);
    noise->step += gain * (seen->step - noise->step);
    noise->large += gain * (seen->large - noise->large);
}

void expected_take(marker_expected_t *expected, const double shape[MARKER_SHAPE], const double variance[MARKER_SHAPE],
                   double hidden) {
    const double bent = UNSURE * hidden * expected->shape[0].value;
    for (int k = 0; k < MARKER_SHAPE; k++) {
        const double told = 1.0 / variance[k] - 1.0 / expected_variance(expected, k);
        if (told > 0.0) { /* else the frame told nothing of it */
            const double value = expected->shape[k].value, own = value + (shape[k] - value) / (told * variance[k]);
            update(&expected->shape[k], own, 1.0 / told + this_frame(expected, k) + bent * bent);
        }
    }
}
