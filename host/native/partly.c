#include "partly.h"

#include <math.h>
#include <string.h>

#include "expected.h"

#define UNKNOWNS (MARKER_SHAPE + 2) /* the outline's terms, then its middle */
#define COARSE   0.15 /* tolerance: of the radius: as wide as edges scatter when the search for the middle begins ... */
#define NARROWER 0.6  /* ... and by how much less each time */
#define PASSES   24   /* tolerance: at most */
#define SETTLED_PX 2e-3 /* tolerance */
#define SQUARE_PX  0.3  /* tolerance: of the rays' middle, up to which they meet the outline squarely */
#define REACH      3.0  /* tolerance: px beyond where the outline may be: no farther are edges looked for */
/* Priors of what is in front. */
#define BEGINS      0.002 /* that it begins, and ends, from a ray to the next, a pixel farther on the rim */
#define ENDS        0.1
#define SHALLOW_PX  0.3  /* depths below the outline are alike in their logarithm from here on */
#define NOT_BEYOND  0.1  /* as often as below the outline an edge of something else lies beyond it */
#define EVEN_PX     0.4  /* sigma: by which its own edge goes deeper from a ray to the next ... */
#define BENT_PX     0.04 /* ... and by which it leaves the straight line through the two before ... */
#define UNEVEN      0.2  /* ... but for a share of them */
#define FARTHEST_PX 1e3  /* tolerance: where a line that leads away from a ray is taken to meet it */
#define MIXED       2    /* rays to either side whose edges what is in front reaches, too, by lens and averages */
#define WHOLE       0.97 /* tolerance: share of the outline beyond which nothing is taken to be in front */
#define ANOTHER     1e-8 /* that the marker is another one than before */

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
    double off[MARKER_RAYS_MAX], left[MARKER_RAYS_MAX] /* of it beside what its neighbour says */,
        row[MARKER_RAYS_MAX][UNKNOWNS];
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

/* An edge's noise by those before it: the autoregression of second order along the rim that has the correlation of
 * neighbours and the variance of low orders that were seen. left: share of the standard deviation that is left. */
typedef struct {
    double one, left_one;         /* by the one before */
    double two, second, left_two; /* by the two before */
} along_t;

static void along_rim(const marker_noise_t *noise, along_t *out) {
    const double alike = expected_alike(noise), together = expected_together(noise);
    double low = -0.95, high = 0.95, variance = 1.0; /* tolerance: within what is stationary */
    for (int pass = 0; pass < 24; pass++) {
        out->second = 0.5 * (low + high);
        out->two = alike * (1.0 - out->second);
        variance = 1.0 - out->two * alike - out->second * (out->two * alike + out->second);
        const double rest = 1.0 - out->two - out->second;
        if (variance < together * rest * rest) {
            low = out->second;
        } else {
            high = out->second;
        }
    }
    out->one = alike;
    out->left_one = sqrt(1.0 - alike * alike);
    out->left_two = sqrt(variance);
}

/* What a ray shows: an edge of the outline or of what is in front, the first of its kind beside the other's, the second
 * or a later one. */
enum { OWN, FRONT, KINDS };
enum { FIRST, SECOND, LATER, AGES };

/* px: how far an edge is from the straight line through the two before. */
static double from_line(const rays_t *rays, int i) {
    const int n = rays->count, one = (i + n - 1) % n, two = (i + n - 2) % n;
    const double inverse = 2.0 * rays->basis[1][1] / fmax(rays->edge[one], STEP) - 1.0 / fmax(rays->edge[two], STEP);
    return fmax(rays->edge[i], STEP) - 1.0 / fmax(inverse, 1.0 / FARTHEST_PX);
}

/* Likelihood of each edge, if it is of a kind and an age. */
static void edge_likelihoods(const rays_t *rays, edges_t *edges, const marker_noise_t *noise, double sigma,
                             double radius, double (*edge)[KINDS][AGES]) {
    const int n = rays->count;
    along_t along;
    along_rim(noise, &along);
    const double second = along.two * along.one + along.second; /* correlation of an edge with the last but one */
    const double bent = BENT_PX * BENT_PX + noise->all * (6.0 - 8.0 * along.one + 2.0 * second);
    const double root = sqrt(2.0 * PI), steps = EVEN_PX * EVEN_PX + 2.0 * noise->step;
    const double per_log = 1.0 / log(1.0 + radius / SHALLOW_PX);
    for (int i = 0; i < n; i++) {
        const double off = edges->off[i], before = edges->off[(i + n - 1) % n], last = edges->off[(i + n - 2) % n];
        const double z = off / sigma, by_one = (off - along.one * before) / (along.left_one * sigma);
        const double by_two = (off - along.two * before - along.second * last) / (along.left_two * sigma);
        const double seen = rays->keep[i] ? 1.0 / (root * sigma) : 0.0, step = off - before, line = from_line(rays, i);
        const double fresh = per_log * (off < 0.0 ? 1.0 : NOT_BEYOND) / (fabs(off) + SHALLOW_PX);
        edge[i][OWN][FIRST] = seen * exp(-0.5 * z * z);
        edge[i][OWN][SECOND] = seen / along.left_one * exp(-0.5 * by_one * by_one);
        edge[i][OWN][LATER] = seen / along.left_two * exp(-0.5 * by_two * by_two);
        edge[i][FRONT][FIRST] = fresh;
        edge[i][FRONT][SECOND] =
            UNEVEN * fresh + (1.0 - UNEVEN) / (root * sqrt(steps)) * exp(-0.5 * step * step / steps);
        edge[i][FRONT][LATER] = UNEVEN * fresh + (1.0 - UNEVEN) / (root * sqrt(bent)) * exp(-0.5 * line * line / bent);
        edges->left[i] = by_two * sigma;
    }
}

/* Which edges are the outline's: a chain of rays round it. What is in front has an edge of its own, which goes on from
 * ray to ray. Returns the log likelihood. */
static double tell(const rays_t *rays, edges_t *edges, const marker_noise_t *noise, double sigma, double radius) {
    static const double other[KINDS] = {BEGINS, ENDS}; /* the probability that the next ray is of the other kind */
    const int n = rays->count;
    double edge[MARKER_RAYS_MAX][KINDS][AGES], forward[MARKER_RAYS_MAX][KINDS][AGES];
    edge_likelihoods(rays, edges, noise, sigma, radius, edge);
    int first = 0; /* the ring is cut where it is its own most surely */
    for (int i = 1; i < n; i++) {
        first = fabs(edges->off[i]) < fabs(edges->off[first]) ? i : first;
    }
    double log_likelihood = 0.0, before[KINDS][AGES] = {{0.0}};
    for (int k = 0; k < n; k++) {
        const int i = (first + k) % n;
        double sum = 0.0;
        for (int kind = 0; kind < KINDS; kind++) {
            const double *same = before[kind], *opposite = before[1 - kind];
            const double begins = k == 0 ? (kind == OWN ? 1.0 - BEGINS : BEGINS)
                                         : other[1 - kind] * (opposite[FIRST] + opposite[SECOND] + opposite[LATER]);
            double *now = forward[i][kind];
            now[FIRST] = begins * edge[i][kind][FIRST];
            now[SECOND] = (1.0 - other[kind]) * same[FIRST] * edge[i][kind][SECOND];
            now[LATER] = (1.0 - other[kind]) * (same[SECOND] + same[LATER]) * edge[i][kind][LATER];
            sum += now[FIRST] + now[SECOND] + now[LATER];
        }
        log_likelihood += log(sum);
        for (int state = 0; state < KINDS * AGES; state++) {
            before[state / AGES][state % AGES] = forward[i][state / AGES][state % AGES] /= sum;
        }
    }
    double after[KINDS][AGES] = {{1.0, 1.0, 1.0}, {1.0, 1.0, 1.0}};
    for (int k = n - 1; k >= 0; k--) {
        const int i = (first + k) % n;
        double share[KINDS] = {0.0}, back[KINDS][AGES], sum = 0.0;
        for (int kind = 0; kind < KINDS; kind++) {
            const double changes = other[kind] * edge[i][1 - kind][FIRST] * after[1 - kind][FIRST];
            for (int age = 0; age < AGES; age++) {
                const int next = age == FIRST ? SECOND : LATER;
                share[kind] += forward[i][kind][age] * after[kind][age];
                back[kind][age] = (1.0 - other[kind]) * edge[i][kind][next] * after[kind][next] + changes;
                sum += back[kind][age];
            }
        }
        edges->own[i] = share[OWN] / (share[OWN] + share[FRONT]);
        for (int state = 0; state < KINDS * AGES; state++) {
            after[state / AGES][state % AGES] = back[state / AGES][state % AGES] / sum;
        }
    }
    return log_likelihood;
}

/* One step of the posterior's mode: x, outline and middle, is moved; a: the curvature's factor. Returns how far the
 * middle went, px, < 0: singular. */
static double step(const rays_t *rays, const marker_expected_t *before, const double towards[2], double sigma,
                   double x[UNKNOWNS], double a[UNKNOWNS_MAX][UNKNOWNS_MAX], partly_t *out) {
    edges_t edges;
    compare(rays, x, &edges);
    const double log_likelihood = tell(rays, &edges, &before->noise, sigma, before->shape[0].value);
    const double together = expected_together(&before->noise);
    double b[UNKNOWNS_MAX] = {0.0}, own = 0.0, square = 0.0;
    memset(a, 0, sizeof(double[UNKNOWNS_MAX][UNKNOWNS_MAX]));
    for (int i = 0; i < rays->count; i++) {
        double clear = edges.own[i]; /* that nothing in front is mixed in from a neighbour */
        for (int k = 1; k <= MIXED; k++) {
            clear = fmin(clear, fmin(edges.own[(i + k) % rays->count], edges.own[(i + rays->count - k) % rays->count]));
        }
        const double *row = edges.row[i], off = edges.off[i], weight = clear / (together * sigma * sigma);
        own += clear;
        square += clear * edges.left[i] * edges.left[i];
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
    const double usual = before->noise.all / (sigma * sigma); /* prior of what edges scatter by in a frame */
    /* Ways from different middles see different edges, in number and smoothness: they count as independent ones do. */
    out->evidence = log_likelihood / together - 0.5 * misfit + volume + 0.5 * AS_MANY * (log(usual) + 1.0 - usual);
    out->own = own / rays->count;
    out->scatter = sqrt(expected_scatter(&before->noise, square, own));
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
    other.noise = before->noise; /* of camera and codec */
    const double coarse = COARSE * before->shape[0].value, scatter = sqrt(before->noise.all);
    const double *whole = shape ? found : NULL;
    const look_t looks[] = {
        /* One hypothesis from several places on, as each is led to the mode that is nearest. */
        {found, NULL, before, coarse, 1.0},
        {expected, NULL, before, coarse, 1.0},
        {expected, NULL, before, scatter, 1.0},
        {last, NULL, before, coarse, 1.0},
        {whole, shape, before, scatter, 1.0},
        /* Another one. */
        {whole, shape, &other, scatter, ANOTHER},
    };
    enum { WAYS = sizeof looks / sizeof *looks };
    partly_t way[WAYS];
    double best = -INFINITY, sum = 0.0;
    for (int i = 0; i < WAYS; i++) {
        const int there = looks[i].from && explain(field, level, expected, &looks[i], &way[i]);
        /* Of the chain's own prior only a part counts, as of its edges. */
        const double prior = looks[i].prior * (there && way[i].own > WHOLE ? 1.0 - HIDDEN : HIDDEN);
        way[i].evidence = there ? way[i].evidence + log(prior) : -INFINITY;
        best = fmax(best, way[i].evidence);
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
                out->another += looks[i].before == &other ? share : 0.0;
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
    return shape && out->own > WHOLE ? PARTLY_WHOLE : PARTLY_SEEN;
}
