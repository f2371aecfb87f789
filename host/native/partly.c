#include "partly.h"

#include <math.h>
#include <string.h>

#include "expected.h"

#define UNKNOWNS   (MARKER_SHAPE + 2) /* the outline's terms, then its middle */
#define COARSE     0.15 /* of the radius: as wide as edges scatter when the search for the middle begins ... */
#define NARROWER   0.6  /* ... and by how much less each time */
#define PASSES     24   /* at most */
#define SETTLED_PX 2e-3 /* tolerance */
#define SQUARE_PX  0.3  /* tolerance: of the rays' middle, up to which they meet the outline squarely */
#define REACH      3.0  /* px beyond where the outline may be: no farther are edges looked for */
#define AS_MANY    8.0  /* prior: edges that the scatter of the frames before counts for */
/* Priors of what is in front. */
#define BEGINS     0.002 /* that it begins, and ends, from a ray to the next, a pixel farther on the rim */
#define ENDS       0.1
#define SHALLOW_PX 0.3  /* depths below the outline are alike in their logarithm from here on */
#define NOT_BEYOND 0.1  /* as often as below the outline an edge of something else lies beyond it */
#define EVEN_PX    0.4  /* sigma: by which its own edge goes deeper from ray to ray ... */
#define UNEVEN     0.2  /* ... but for a share of them */
#define MIXED      2    /* rays to either side whose edges what is in front reaches, too, by lens and averages */
#define WHOLE      0.97 /* tolerance: share of the outline beyond which nothing is taken to be in front */
#define ANOTHER    1e-8 /* that the marker is another one than before */

/* The outline's terms at an edge (dx, dy) px from its middle, and their derivatives by the angle. */
static void turn(double dx, double dy, double r, double terms[MARKER_SHAPE], double by_angle[MARKER_SHAPE]) {
    double along = dx / r, across = dy / r;
    const double c = along, s = across;
    terms[0] = 1.0;
    by_angle[0] = 0.0;
    for (int k = 2; 2 * k - 1 <= MARKER_SHAPE; k++) {
        const double next = along * c - across * s;
        across = across * c + along * s;
        along = next;
        terms[2 * k - 3] = along;
        terms[2 * k - 2] = across;
        by_angle[2 * k - 3] = -k * across;
        by_angle[2 * k - 2] = k * along;
    }
}

/* The edges about an outline: how far beyond it, px, and the rows that they are of. */
typedef struct {
    double off[MARKER_RAYS_MAX], row[MARKER_RAYS_MAX][UNKNOWNS];
    double own[MARKER_RAYS_MAX]; /* probability that it is the outline's */
} edges_t;

/* x: the outline's terms, and its middle from that of the rays. */
static void compare(const rays_t *rays, const double x[UNKNOWNS], edges_t *edges) {
    for (int i = 0; i < rays->count; i++) {
        const double dx = rays->edge[i] * rays->basis[i][1] - x[MARKER_SHAPE];
        const double dy = rays->edge[i] * rays->basis[i][2] - x[MARKER_SHAPE + 1];
        const double r = fmax(sqrt(dx * dx + dy * dy), STEP);
        double by_angle[MARKER_SHAPE], off = r, turning = 0.0, *row = edges->row[i];
        turn(dx, dy, r, row, by_angle);
        for (int k = 0; k < MARKER_SHAPE; k++) {
            off -= x[k] * row[k];
            turning += x[k] * by_angle[k];
        }
        row[MARKER_SHAPE] = (dx - turning * dy / r) / r;
        row[MARKER_SHAPE + 1] = (dy + turning * dx / r) / r;
        edges->off[i] = off;
    }
}

/* Which edges are the outline's: a chain of rays round it, own or not. What is in front has an edge of its own, which
 * goes on from ray to ray. Returns the log likelihood. */
static double tell(const rays_t *rays, edges_t *edges, double sigma, double radius) {
    const int n = rays->count;
    const double peak = 1.0 / (sqrt(2.0 * PI) * sigma), even = (1.0 - UNEVEN) / (sqrt(2.0 * PI) * EVEN_PX);
    const double per_log = 1.0 / log(1.0 + radius / SHALLOW_PX);
    double forward[MARKER_RAYS_MAX][2], own[MARKER_RAYS_MAX], fresh[MARKER_RAYS_MAX], goes_on[MARKER_RAYS_MAX];
    int first = 0;
    for (int i = 0; i < n; i++) {
        const double off = edges->off[i], z = off / sigma;
        own[i] = rays->keep[i] ? peak * exp(-0.5 * z * z) : 0.0;
        fresh[i] = per_log * (off < 0.0 ? 1.0 : NOT_BEYOND) / (fabs(off) + SHALLOW_PX);
        const double by = (off - edges->off[(i + n - 1) % n]) / EVEN_PX;
        goes_on[i] = UNEVEN * fresh[i] + even * exp(-0.5 * by * by);
        first = fabs(off) < fabs(edges->off[first]) ? i : first;
    }
    double log_likelihood = 0.0, before[2] = {1.0, 0.0}; /* the ring is cut where it is its own most surely */
    for (int k = 0; k < n; k++) {
        const int i = (first + k) % n;
        double *now = forward[i];
        now[0] = own[i] * (before[0] * (1.0 - BEGINS) + before[1] * ENDS);
        now[1] = before[0] * BEGINS * fresh[i] + before[1] * (1.0 - ENDS) * goes_on[i];
        const double sum = now[0] + now[1];
        log_likelihood += log(sum);
        before[0] = now[0] /= sum;
        before[1] = now[1] /= sum;
    }
    double after[2] = {1.0, 1.0};
    for (int k = n - 1; k >= 0; k--) {
        const int i = (first + k) % n;
        const double mine = forward[i][0] * after[0], other = forward[i][1] * after[1];
        edges->own[i] = mine / (mine + other);
        const double by_own = own[i] * after[0], by_fresh = fresh[i] * after[1], by_on = goes_on[i] * after[1];
        after[0] = by_own * (1.0 - BEGINS) + BEGINS * by_fresh;
        after[1] = by_own * ENDS + (1.0 - ENDS) * by_on;
        const double sum = after[0] + after[1];
        after[0] /= sum;
        after[1] /= sum;
    }
    return log_likelihood;
}

/* One step of the posterior's mode: x, outline and middle, is moved; a: the curvature's factor. Returns how far the
 * middle went, px, < 0: singular. */
static double step(const rays_t *rays, const marker_expected_t *before, const double towards[2], double sigma,
                   double x[UNKNOWNS], double a[UNKNOWNS_MAX][UNKNOWNS_MAX], partly_t *out) {
    edges_t edges;
    compare(rays, x, &edges);
    const double log_likelihood = tell(rays, &edges, sigma, before->shape[0].value);
    double b[UNKNOWNS_MAX] = {0.0}, own = 0.0, square = 0.0;
    memset(a, 0, sizeof(double[UNKNOWNS_MAX][UNKNOWNS_MAX]));
    for (int i = 0; i < rays->count; i++) {
        double clear = edges.own[i]; /* that nothing in front is mixed in from a neighbour */
        for (int k = 1; k <= MIXED; k++) {
            clear = fmin(clear, fmin(edges.own[(i + k) % rays->count], edges.own[(i + rays->count - k) % rays->count]));
        }
        const double *row = edges.row[i], off = edges.off[i], weight = clear / (CORRELATION * sigma * sigma);
        own += clear;
        square += clear * off * off;
        for (int j = 0; j < UNKNOWNS; j++) {
            b[j] += weight * row[j] * off;
            for (int k = 0; k <= j; k++) {
                a[j][k] += weight * row[j] * row[k];
            }
        }
    }
    double misfit = 0.0, volume = 0.0;
    for (int k = 0; k < MARKER_SHAPE; k++) {
        const double away = before->shape[k].value - x[k], variance = expected_variance(before, k);
        a[k][k] += 1.0 / variance;
        b[k] += away / variance;
        misfit += away * away / variance;
        volume -= 0.5 * log(variance);
    }
    const double near = 2.0 * before->shape[0].value; /* prior, sigma: of the middle, from where it should be */
    for (int k = 0; k < 2; k++) {
        const double away = towards[k] - x[MARKER_SHAPE + k];
        a[MARKER_SHAPE + k][MARKER_SHAPE + k] += 1.0 / (near * near);
        b[MARKER_SHAPE + k] += away / (near * near);
        misfit += away * away / (near * near);
        volume -= log(near);
    }
    if (!rays_solve(a, b, UNKNOWNS)) {
        return -1.0;
    }
    for (int k = 0; k < UNKNOWNS; k++) {
        volume -= log(a[k][k]);
    }
    out->evidence = log_likelihood / CORRELATION - 0.5 * misfit + volume;
    out->own = own / rays->count;
    out->scatter = sqrt((AS_MANY * before->scatter * before->scatter + square) / (AS_MANY + own));
    for (int k = 0; k < UNKNOWNS; k++) {
        x[k] += b[k];
    }
    return hypot(b[MARKER_SHAPE], b[MARKER_SHAPE + 1]);
}

/* The variances of what a factor of the curvature belongs to. */
static void variances(double a[UNKNOWNS_MAX][UNKNOWNS_MAX], double variance[UNKNOWNS]) {
    double inverse[UNKNOWNS][UNKNOWNS] = {{0.0}}; /* of the factor */
    for (int j = 0; j < UNKNOWNS; j++) {
        inverse[j][j] = 1.0 / a[j][j];
        for (int i = j + 1; i < UNKNOWNS; i++) {
            for (int k = j; k < i; k++) {
                inverse[i][j] -= a[i][k] * inverse[k][j];
            }
            inverse[i][j] /= a[i][i];
        }
        variance[j] = 0.0;
        for (int i = j; i < UNKNOWNS; i++) {
            variance[j] += inverse[i][j] * inverse[i][j];
        }
    }
}

/* A way to look at a frame: from where, with what is known beforehand, from which outline on, and how coarsely. */
typedef struct {
    const double *from, *shape;
    const marker_expected_t *before;
    double coarse, prior;
} look_t;

/* What a frame shows when it is looked at so. 0: nothing. */
static int explain(const field_t *field, const double level[PLANE], const double expected[2], const look_t *look,
                   partly_t *out) {
    rays_t rays;
    double unknown[UNKNOWNS], a[UNKNOWNS_MAX][UNKNOWNS_MAX], variance[UNKNOWNS];
    const double radius = look->before->shape[0].value;
    double x = look->from[0], y = look->from[1], sigma = look->coarse;
    rays_aim(&rays, radius);
    for (int k = 0; k < MARKER_SHAPE; k++) {
        unknown[k] = look->shape ? look->shape[k] : look->before->shape[k].value;
    }
    for (int again = 0; again < 2; again++) {
        const double towards[] = {expected[0] - x, expected[1] - y};
        const double here[PLANE] = {level[0] + level[1] * x + level[2] * y, level[1], level[2]};
        if (!(x >= 0.0 && y >= 0.0 && x <= field->columns - 1.0 && y <= field->rows - 1.0)) {
            return 0;
        }
        (void)rays_look_beyond(&rays, field, ABOVE, x, y, 1.5 * radius + REACH);
        rays_find_edges(&rays, field, x, y, here);
        unknown[MARKER_SHAPE] = unknown[MARKER_SHAPE + 1] = 0.0;
        double aside = 0.0;
        for (int pass = 0; pass < PASSES; pass++) {
            const double moved = step(&rays, look->before, towards, sigma, unknown, a, out);
            if (!(moved >= 0.0 && moved <= radius)) {
                return 0;
            }
            aside = hypot(unknown[MARKER_SHAPE], unknown[MARKER_SHAPE + 1]);
            const double narrow = fmax(out->scatter, NARROWER * sigma);
            if (narrow > 0.95 * sigma && (moved < SETTLED_PX || (again == 0 && moved < 0.1 * aside))) {
                break;
            }
            sigma = narrow;
        }
        x += unknown[MARKER_SHAPE];
        y += unknown[MARKER_SHAPE + 1];
        if (aside < SQUARE_PX) {
            break;
        }
    }
    variances(a, variance);
    out->x = x;
    out->y = y;
    out->variance = 0.5 * (variance[MARKER_SHAPE] + variance[MARKER_SHAPE + 1]);
    memcpy(out->shape, unknown, sizeof out->shape);
    memcpy(out->of_shape, variance, sizeof out->of_shape);
    return 1;
}

int partly_weigh(const field_t *field, const double level[PLANE], const marker_expected_t *before,
                 const double expected[2], const double last[2], const double found[2], const double *shape,
                 partly_t *out) {
    marker_expected_t other;
    marker_expect(2.0 * before->shape[0].value, &other);
    const double coarse = COARSE * before->shape[0].value;
    const double *whole = shape ? found : NULL;
    const look_t looks[] = {
        /* One hypothesis from several places on, as each is led to the mode that is nearest. */
        {found, NULL, before, coarse, 1.0},
        {expected, NULL, before, coarse, 1.0},
        {last, NULL, before, coarse, 1.0},
        {whole, shape, before, before->scatter, 1.0},
        /* Another one. */
        {whole, shape, &other, before->scatter, ANOTHER},
    };
    enum { WAYS = sizeof looks / sizeof *looks };
    partly_t way[WAYS];
    double best = -INFINITY, sum = 0.0;
    for (int i = 0; i < WAYS; i++) {
        const int there = looks[i].from && explain(field, level, expected, &looks[i], &way[i]);
        way[i].evidence = there ? way[i].evidence + log(looks[i].prior) : -INFINITY;
        best = fmax(best, way[i].evidence);
        if (i == 0 && there && shape && way[i].own > WHOLE) {
            *out = way[i];
            return PARTLY_WHOLE;
        }
    }
    memset(out, 0, sizeof *out);
    if (!(best > -INFINITY)) {
        return PARTLY_NOT;
    }
    for (int i = 0; i < WAYS; i++) {
        sum += exp(way[i].evidence - best);
    }
    out->evidence = best + log(sum);
    for (int pass = 0; pass < 2; pass++) { /* means, then what is spread about them */
        for (int i = 0; i < WAYS; i++) {
            const double share = exp(way[i].evidence - out->evidence);
            if (!(share > 0.0)) {
                continue;
            }
            const double dx = way[i].x - out->x, dy = way[i].y - out->y;
            if (pass == 0) {
                out->x += share * way[i].x;
                out->y += share * way[i].y;
                out->scatter += share * way[i].scatter;
                out->own += share * way[i].own;
            } else {
                out->variance += share * (way[i].variance + 0.5 * (dx * dx + dy * dy));
            }
            for (int k = 0; k < MARKER_SHAPE; k++) {
                const double away = way[i].shape[k] - out->shape[k];
                if (pass == 0) {
                    out->shape[k] += share * way[i].shape[k];
                } else {
                    out->of_shape[k] += share * (way[i].of_shape[k] + away * away);
                }
            }
        }
    }
    return PARTLY_SEEN;
}
