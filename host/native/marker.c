#include "marker.h"

#include <math.h>
#include <string.h>

#include "expected.h"
#include "partly.h"
#include "rays.h"

#define SMALLEST  12   /* limit: px, area */
#define SHADE     0.3  /* prior, sigma: of the contrast, from the middle to the rim */
#define OFTEN     1e-3 /* prior: that from a frame to the next the light is another one; less is no reason */
#define ELSEWHERE 0.6  /* tolerance: of the radius: where it was is looked at, too, when it should be farther away */
#define CERTAIN   -3.5 /* tolerance: log odds that a part is hidden, below which it is not asked for */
#define RISES     0.1  /* tolerance: of the contrast within 2 px: what is around is mixed in, by lens or motion */
#define FINEST    1e-3 /* limit: membership: no pixel is known better */
#define PIXELS_TOGETHER 3.0 /* prior: of so many neighbouring pixels one is independent, in MJPEG; measured */

typedef struct {
    int x, y; /* first row's first pixel that the flood reached: where to flood again */
    int area, clipped, cut_off;
    double sum_x, sum_y;
} blob_t;

size_t marker_scratch_size(size_t pixels) {
    return pixels * (5 * sizeof(float) + sizeof(int32_t) + sizeof(uint8_t));
}

/* Marks the region of `from` (4-connected) in `mark` that holds start with `to`. */
static blob_t flood(const marker_view_t *view, uint8_t *mark, int32_t *stack, int start, uint8_t from, uint8_t to) {
    const int columns = view->x1 - view->x0, rows = view->y1 - view->y0;
    blob_t blob = {start % columns, start / columns, 0, 0, 0, 0.0, 0.0};
    int top = 0;
    stack[top++] = start;
    mark[start] = to;
    while (top > 0) {
        const int at = stack[--top], x = at % columns, y = at / columns;
        blob.area++;
        blob.sum_x += x;
        blob.sum_y += y;
        if (x == 0 || y == 0 || x == columns - 1 || y == rows - 1) {
            const int u = x + view->x0, v = y + view->y0;
            if (u == 0 || v == 0 || u == view->width - 1 || v == view->height - 1) {
                blob.cut_off = 1;
            } else {
                blob.clipped = 1;
            }
        }
        if (x > 0 && mark[at - 1] == from) {
            mark[at - 1] = to;
            stack[top++] = at - 1;
        }
        if (x < columns - 1 && mark[at + 1] == from) {
            mark[at + 1] = to;
            stack[top++] = at + 1;
        }
        if (y > 0 && mark[at - columns] == from) {
            mark[at - columns] = to;
            stack[top++] = at - columns;
        }
        if (y < rows - 1 && mark[at + columns] == from) {
            mark[at + columns] = to;
            stack[top++] = at + columns;
        }
    }
    return blob;
}

/* Least squares for the first `terms` of the outline, with `weight` a ray. 0: too few rays. */
static int fit_weighted(rays_t *rays, const double *weight, int terms) {
    double a[UNKNOWNS_MAX][UNKNOWNS_MAX] = {{0.0}}, b[UNKNOWNS_MAX] = {0.0};
    for (int i = 0; i < rays->count; i++) {
        for (int j = 0; j < terms; j++) {
            const double w = weight[i] * rays->basis[i][j];
            b[j] += w * rays->edge[i];
            for (int k = 0; k <= j; k++) {
                a[j][k] += w * rays->basis[i][k];
            }
        }
    }
    if (!rays_solve(a, b, terms)) {
        return 0;
    }
    for (int i = 0; i < rays->count; i++) {
        rays->fit[i] = 0.0;
        for (int j = 0; j < terms; j++) {
            rays->fit[i] += b[j] * rays->basis[i][j];
        }
    }
    return 1;
}

/* 1.4826 times the median distance of the edges from the outline: the sigma of those that fit. */
static double spread(const rays_t *rays) {
    float size[MARKER_RAYS_MAX];
    for (int i = 0; i < rays->count; i++) {
        size[i] = (float)fabs(rays->edge[i] - rays->fit[i]);
    }
    return fmax(1.4826 * (double)rays_kth(size, rays->count, rays->count / 2), 0.02);
}

/* What edges scatter by about a whole outline of this shape. Its own orders, up to 4, are taken from the fit; the noise
 * there is as large as in the next three. Returns the sum of their squares. */
static double read_noise(const rays_t *rays, const double shape[MARKER_SHAPE], marker_noise_t *seen) {
    enum { NEXT = 3 };
    double off[MARKER_RAYS_MAX], along[NEXT] = {0.0}, across[NEXT] = {0.0}, square = 0.0, steps = 0.0;
    int kept = 0, pairs = 0;
    for (int i = 0; i < rays->count; i++) {
        const double *b = rays->basis[i];
        double c = b[3] * b[3] - b[4] * b[4], s = 2.0 * b[3] * b[4]; /* of order 4 */
        off[i] = rays->keep[i] ? rays->edge[i] - rays->fit[i] - shape[5] * c - shape[6] * s : 0.0;
        square += off[i] * off[i];
        kept += rays->keep[i];
        for (int k = 0; k < NEXT; k++) {
            const double turned = c * b[1] - s * b[2];
            s = s * b[1] + c * b[2];
            c = turned;
            along[k] += off[i] * c;
            across[k] += off[i] * s;
        }
        if (i > 0 && rays->keep[i] && rays->keep[i - 1]) {
            steps += 0.5 * (off[i] - off[i - 1]) * (off[i] - off[i - 1]);
            pairs++;
        }
    }
    seen->large = 0.0;
    for (int k = 0; k < NEXT; k++) {
        seen->large += (along[k] * along[k] + across[k] * across[k]) / (NEXT * kept);
    }
    seen->all = (square + UNKNOWNS_MAX * seen->large) / kept;
    seen->step = pairs > 0 ? steps / pairs : seen->all;
    return square;
}

/* The outline through the edges that agree. What touches the marker on one side must not bend it: it starts as a circle
 * of median radius, becomes an ellipse with Cauchy's weights, and takes its last order without the strays (3 sigma).
 * Returns how many edges it keeps, 0: no fit. */
static int fit_outline(rays_t *rays) {
    double weight[MARKER_RAYS_MAX];
    float sorted[MARKER_RAYS_MAX];
    for (int i = 0; i < rays->count; i++) {
        sorted[i] = (float)rays->edge[i];
    }
    const double median = rays_kth(sorted, rays->count, rays->count / 2);
    for (int i = 0; i < rays->count; i++) {
        rays->fit[i] = median;
    }
    double before = 1e9;
    for (int pass = 0; pass < 8; pass++) {
        const double now = spread(rays), scale = 2.0 * now;
        if (now > 0.9 * before) { /* settled */
            break;
        }
        before = now;
        for (int i = 0; i < rays->count; i++) {
            const double x = (rays->edge[i] - rays->fit[i]) / scale;
            weight[i] = rays->keep[i] ? 1.0 / (1.0 + x * x) : 0.0;
        }
        if (!fit_weighted(rays, weight, TERMS - 2)) {
            return 0;
        }
    }
    int kept = 0;
    for (int pass = 0; pass < 2; pass++) {
        const double limit = 3.0 * spread(rays);
        kept = 0;
        for (int i = 0; i < rays->count; i++) {
            rays->keep[i] = rays->keep[i] && fabs(rays->edge[i] - rays->fit[i]) < limit;
            weight[i] = rays->keep[i];
            kept += rays->keep[i];
        }
        if (kept < 2 * TERMS || !fit_weighted(rays, weight, TERMS)) {
            return 0;
        }
    }
    return kept;
}

/* The outline where the marker's own level is `level`: its centroid from (cx, cy), and its diameter. Returns
 * how many edges it keeps, 0: none. */
static int outline(rays_t *rays, const field_t *field, double cx, double cy, const double level[PLANE], double place[2],
                   marker_outline_t *out) {
    rays_find_edges(rays, field, cx, cy, level);
    const int kept = fit_outline(rays);
    if (kept == 0) {
        return 0;
    }
    /* The outline r(t): area 1/2 r^2 dt, moments 1/3 r^3 (cos t, sin t) dt. */
    double twice_area = 0.0, mx = 0.0, my = 0.0;
    for (int i = 0; i < rays->count; i++) {
        const double r = rays->fit[i];
        twice_area += r * r;
        mx += r * r * r * rays->basis[i][1];
        my += r * r * r * rays->basis[i][2];
    }
    place[0] = 2.0 / 3.0 * mx / twice_area;
    place[1] = 2.0 / 3.0 * my / twice_area;
    out->diameter = 2.0 * sqrt(twice_area / rays->count);
    return kept;
}

/* The terms of the outline about its middle, which is near the rays': those up to order 3 from its fit, the rest from
 * what that leaves. */
static void read_shape(const rays_t *rays, double shape[MARKER_SHAPE]) {
    memset(shape, 0, MARKER_SHAPE * sizeof *shape);
    for (int i = 0; i < rays->count; i++) {
        const double *b = rays->basis[i], r = rays->fit[i], off = rays->keep[i] ? rays->edge[i] - r : 0.0;
        shape[0] += r;
        for (int k = 1; k < 5; k++) {
            shape[k] += 2.0 * r * b[k + 2];
        }
        shape[5] += 2.0 * off * (b[3] * b[3] - b[4] * b[4]);
        shape[6] += 2.0 * off * 2.0 * b[3] * b[4];
    }
    for (int k = 0; k < MARKER_SHAPE; k++) {
        shape[k] /= rays->count;
    }
}

/* px, of the disc with an outline's area. */
static double mean_radius(const double shape[MARKER_SHAPE]) {
    double square = shape[0] * shape[0];
    for (int k = 1; k < MARKER_SHAPE; k++) {
        square += 0.5 * shape[k] * shape[k];
    }
    return sqrt(square);
}

/* Marks the best blob near (u, v) as such and what else is above the cut as OTHER. 0: there is none. */
static int search(const marker_view_t *view, uint8_t *mark, int32_t *stack, double u, double v, double diameter,
                  blob_t *best) {
    const int columns = view->x1 - view->x0, pixels = columns * (view->y1 - view->y0);
    double best_score = 0.0;
    memset(best, 0, sizeof *best);
    for (int i = 0; i < pixels; i++) {
        if (mark[i] != ABOVE) {
            continue;
        }
        const int first = best_score == 0.0;
        const blob_t blob = flood(view, mark, stack, i, ABOVE, first ? BLOB : OTHER);
        const double dx = view->x0 + blob.sum_x / blob.area - u, dy = view->y0 + blob.sum_y / blob.area - v;
        const double score = blob.area / (1.0 + (dx * dx + dy * dy) / (diameter * diameter));
        if (score > best_score) {
            if (!first) {
                (void)flood(view, mark, stack, best->y * columns + best->x, BLOB, OTHER);
                (void)flood(view, mark, stack, blob.y * columns + blob.x, OTHER, BLOB);
            }
            best_score = score;
            *best = blob;
        }
    }
    return best->area >= SMALLEST;
}

/* Pixels that show the marker alone: places from its middle, px, levels, and room for as many again. */
typedef struct {
    int count;
    float *x, *y, *level, *room;
} inside_t;

/* How far what is around is mixed into the marker, px from its rim: on all but a quarter of the rays no farther. */
static double rim_width(const rays_t *rays, const field_t *field, double cx, double cy, double contrast) {
    float width[MARKER_RAYS_MAX];
    int count = 0;
    for (int i = 0; i < rays->count; i += 2) { /* neighbours share pixels */
        double r = rays->crossing[i];
        float level[5]; /* the first 2 px further in than the last */
        for (; r > 2.0; r -= STEP) {
            rays_sample(field, cx, cy, rays->basis[i], r - 2.0, 5, level);
            if ((double)(level[0] - level[4]) < RISES * contrast) {
                break;
            }
        }
        width[count++] = (float)(rays->crossing[i] - r);
    }
    return (double)rays_kth(width, count, 3 * count / 4);
}

/* The blob's pixels that show it alone. */
static void gather(inside_t *inside, const field_t *field, double cx, double cy, double alone) {
    const int columns = field->columns, rows = field->rows;
    const int top = (int)fmax(cy - alone, 0.0), bottom = (int)fmin(cy + alone + 1.0, rows);
    const int left = (int)fmax(cx - alone, 0.0), right = (int)fmin(cx + alone + 1.0, columns);
    for (int row = top; row < bottom; row++) {
        for (int column = left; column < right; column++) {
            const double dx = column - cx, dy = row - cy;
            if (dx * dx + dy * dy < alone * alone && field->mark[row * columns + column] == BLOB) {
                inside->x[inside->count] = (float)dx;
                inside->y[inside->count] = (float)dy;
                inside->level[inside->count++] = field->y[row * columns + column];
            }
        }
    }
}

/* The plane through their levels, with Cauchy's weights: a glint, white, changes little and is left out where it burns.
 * Returns the variance of its slopes. */
static double fit_plane(const inside_t *inside, double within, double plane[PLANE]) {
    double variance = INFINITY, before = INFINITY;
    plane[0] = within;
    plane[1] = plane[2] = 0.0;
    for (int pass = 0; pass < 5 && inside->count >= SMALLEST; pass++) {
        const float level = (float)plane[0], along = (float)plane[1], across = (float)plane[2];
        for (int i = 0; i < inside->count; i++) {
            inside->room[i] = fabsf(inside->level[i] - level - along * inside->x[i] - across * inside->y[i]);
        }
        const double sigma = fmax(1.4826 * (double)rays_kth(inside->room, inside->count, inside->count / 2), FINEST);
        if (sigma > 0.98 * before) { /* settled */
            break;
        }
        before = sigma;
        const float scale = (float)(0.5 / sigma);
        double a[UNKNOWNS_MAX][UNKNOWNS_MAX] = {{0.0}}, b[UNKNOWNS_MAX] = {0.0};
        for (int i = 0; i < inside->count; i++) {
            const float x = inside->x[i], y = inside->y[i], value = inside->level[i];
            const float left = (value - level - along * x - across * y) * scale, weight = 1.0F / (1.0F + left * left);
            a[0][0] += (double)weight;
            a[1][0] += (double)(weight * x);
            a[1][1] += (double)(weight * x * x);
            a[2][0] += (double)(weight * y);
            a[2][1] += (double)(weight * y * x);
            a[2][2] += (double)(weight * y * y);
            b[0] += (double)(weight * value);
            b[1] += (double)(weight * value * x);
            b[2] += (double)(weight * value * y);
        }
        const double spread = a[1][1] + a[2][2] - (a[1][0] * a[1][0] + a[2][0] * a[2][0]) / a[0][0];
        if (!rays_solve(a, b, PLANE)) {
            return INFINITY;
        }
        memcpy(plane, b, PLANE * sizeof *plane);
        variance = PIXELS_TOGETHER * sigma * sigma / (0.5 * spread);
    }
    return variance;
}

/* The probability that the marker is lit from one side, by that before and what a plane's slopes say: their square and
 * variance, shares of the contrast from the middle to the rim. */
static double lit_from_one_side(double before, double square, double variance) {
    const double shaded = before * (1.0 - OFTEN) + (1.0 - before) * OFTEN, both = SHADE * SHADE + variance;
    const double odds =
        log(shaded / (1.0 - shaded)) + log(variance / both) + 0.5 * square * (1.0 / variance - 1.0 / both);
    return 1.0 / (1.0 + exp(-odds));
}

/* A fresh frame is not in the cache: its rows are asked for all at once, not one after the other. */
static void prefetch(const marker_view_t *view) {
#if defined(__GNUC__)
    for (int row = view->y0; row < view->y1; row++) {
        const uint8_t *p = view->bgr + row * view->stride;
        for (int byte = 3 * view->x0; byte < 3 * view->x1; byte += 64) {
            __builtin_prefetch(p + byte);
        }
    }
#else
    (void)view;
#endif
}

/* Where a frame is looked at, px in the region: where the marker should be, and where the blob's middle is. */
typedef struct {
    const marker_view_t *view;
    const field_t *field;
    const marker_expected_t *before;
    double expected[2], blob[2];
} view_of_t;

/* Puts what is seen of a marker of which a part may be hidden in place of its whole outline in `out`. even: its level.
 * lit, about the blob's middle: its level by the light, NULL: it is even. shape: of the whole outline, NULL: there is
 * none. Returns one of PARTLY_*; all of it is seen: `out` stands. */
static int see_part(const view_of_t *of, const double even[PLANE], const double *lit, const double *shape,
                    marker_outline_t *out) {
    const marker_expected_t *before = of->before, expected = out->after;
    const double found[2] = {out->u - of->view->x0, out->v - of->view->y0};
    const double last[2] = {before->u - of->view->x0, before->v - of->view->y0};
    const double away = hypot(last[0] - of->expected[0], last[1] - of->expected[1]);
    const int elsewhere = before->seen && away > ELSEWHERE * before->shape[0].value;
    partly_t part, shifted;
    const int seen =
        partly_weigh(of->field, even, &expected, of->expected, elsewhere ? last : NULL, found, shape, &part);
    if (seen == PARTLY_WHOLE) { /* by how much what was expected of its shape would move it */
        out->sigma = hypot(out->sigma, hypot(part.x - found[0], part.y - found[1]) / sqrt(2.0));
    }
    if (seen == PARTLY_WHOLE && part.another > 0.5) { /* the loss: what is known is one marker's */
        marker_expected_t other;
        marker_expect(out->diameter, &other);
        expected_at(&other, out->u, out->v, &out->after);
        out->after.noise = expected.noise;
        out->after.shaded = expected.shaded;
    }
    if (seen != PARTLY_SEEN) {
        return seen;
    }
    out->lit_u = out->lit_v = 0.0;
    if (lit) {
        const double level[PLANE] = {lit[0] - lit[1] * of->blob[0] - lit[2] * of->blob[1], lit[1], lit[2]};
        const double here[2] = {part.x, part.y};
        if (partly_weigh(of->field, level, &expected, here, NULL, here, NULL, &shifted) != PARTLY_NOT) {
            out->lit_u = shifted.x - part.x;
            out->lit_v = shifted.y - part.y;
        }
    }
    out->u = of->view->x0 + part.x + out->lit_u;
    out->v = of->view->y0 + part.y + out->lit_v;
    out->sigma = sqrt(part.variance);
    out->scatter = part.scatter;
    out->kept = part.own;
    out->diameter = 2.0 * mean_radius(part.shape);
    expected_at(before, out->u, out->v, &out->after);
    out->after.shaded = expected.shaded;
    expected_take(&out->after, part.shape, part.of_shape, 1.0 - part.own);
    const double times = part.scatter * part.scatter / expected.noise.all;
    const marker_noise_t noise = {1.0, times * expected.noise.all, times * expected.noise.step,
                                  times * expected.noise.large};
    expected_learn_noise(&out->after, &noise, part.own);
    return seen;
}

int marker_measure(const marker_view_t *view, const float weights[4], double cut, double u, double v, double diameter,
                   const marker_expected_t *before, void *scratch, marker_outline_t *out) {
    const int columns = view->x1 - view->x0, rows = view->y1 - view->y0;
    const size_t pixels = (size_t)columns * (size_t)rows;
    float *y = scratch;
    float *core = y + pixels;
    inside_t inside = {0, core + pixels, core + 2 * pixels, core + 3 * pixels, core};
    int32_t *stack = (int32_t *)(core + 4 * pixels);
    uint8_t *mark = (uint8_t *)(stack + pixels);
    memset(out, 0, sizeof *out);
    out->after = *before;

    prefetch(view);
    for (int row = 0; row < rows; row++) {
        const uint8_t *p = view->bgr + (view->y0 + row) * view->stride + 3 * view->x0;
        for (int column = 0; column < columns; column++, p += 3) {
            const float m = weights[0] * p[0] + weights[1] * p[1] + weights[2] * p[2] + weights[3];
            y[row * columns + column] = m;
            mark[row * columns + column] = m > (float)cut ? ABOVE : BELOW;
        }
    }
    blob_t blob;
    if (!search(view, mark, stack, u, v, diameter, &blob)) {
        return MARKER_NONE;
    }
    const double area = blob.area;
    double cx = blob.sum_x / area, cy = blob.sum_y / area;
    const double radius = sqrt(area / PI);

    int count = 0;
    double furthest = 0.0;
    for (int row = 0; row < rows; row++) {
        const uint8_t *p = view->bgr + (view->y0 + row) * view->stride + 3 * view->x0;
        for (int column = 0; column < columns; column++) {
            if (mark[row * columns + column] != BLOB) {
                continue;
            }
            const double dx = column - cx, dy = row - cy, square = dx * dx + dy * dy;
            furthest = square > furthest ? square : furthest;
            if (square < 0.5 * radius * radius) {
                core[count++] = y[row * columns + column];
                for (int k = 0; k < 3; k++) {
                    out->colour[k] += p[3 * column + k];
                }
            }
        }
    }
    furthest = sqrt(furthest);
    out->u = view->x0 + cx;
    out->v = view->y0 + cy;
    out->diameter = 2.0 * radius;
    if (count == 0) { /* a ring, a crescent: no marker has its middle outside of itself */
        return MARKER_NONE;
    }
    out->within = rays_kth(core, count, count / 2);
    for (int k = 0; k < 3; k++) {
        out->colour[k] /= count;
    }
    if (blob.cut_off || blob.clipped) {
        return blob.cut_off ? MARKER_CUT_OFF : MARKER_CLIPPED;
    }

    const field_t field = {y, mark, columns, rows};
    rays_t rays;
    rays_aim(&rays, radius);
    out->around = rays_look_beyond(&rays, &field, BLOB, cx, cy, furthest + 1.0);
    if (!(out->within > out->around)) {
        return MARKER_NONE;
    }
    const double even[PLANE] = {out->within, 0.0, 0.0};
    double place[2];
    const int kept = outline(&rays, &field, cx, cy, even, place, out);
    const double rim = rim_width(&rays, &field, cx, cy, out->within - out->around);
    gather(&inside, &field, cx, cy, fmax(radius - rim, 0.0));
    double level[PLANE];
    const double variance = fit_plane(&inside, out->within, level);
    if (kept > 0 && variance < INFINITY) {
        const double share = radius / (out->within - out->around), slopes = level[1] * level[1] + level[2] * level[2];
        out->after.shaded = lit_from_one_side(before->shaded, share * share * slopes, share * share * variance);
    }
    const int lit = variance < INFINITY && out->after.shaded > OFTEN;
    if (lit) {
        level[0] = out->within + out->after.shaded * (level[0] - out->within);
        level[1] *= out->after.shaded;
        level[2] *= out->after.shaded;
    }
    if (kept > 0 && lit) {
        marker_outline_t shifted = {0}; /* tells the shift alone: what else is said is of the outline that is shifted */
        double there[2];
        if (outline(&rays, &field, cx, cy, level, there, &shifted) > 0) {
            out->lit_u = there[0] - place[0];
            out->lit_v = there[1] - place[1];
            memcpy(place, there, sizeof place);
        }
    }
    out->kept = (double)kept / rays.count;
    double shape[MARKER_SHAPE];
    marker_noise_t noise;
    if (kept > 0) {
        read_shape(&rays, shape);
        const double square = read_noise(&rays, shape, &noise), together = expected_together(&before->noise);
        out->scatter = sqrt(expected_scatter(&before->noise, square, kept - UNKNOWNS_MAX * together));
    }
    /* The centroid is the outline's first harmonic, whose variance is 2/n that of an edge. */
    out->sigma = kept > 0 ? out->scatter * sqrt(2.0 / kept * expected_together(&before->noise)) : 0.0;
    if (kept > 0) {
        out->u += place[0];
        out->v += place[1];
    }
    marker_expected_t expected;
    expected_at(before, out->u, out->v, &expected);
    expected.shaded = out->after.shaded;
    out->after = expected;
    int seen = PARTLY_WHOLE;
    const double hidden =
        kept > 0 ? expected_hidden(&expected, shape, out->scatter, kept, rays.count) : (double)INFINITY;
    if (hidden > CERTAIN) {
        const view_of_t of = {view, &field, before, {u - view->x0, v - view->y0}, {cx, cy}};
        seen = see_part(&of, even, lit ? level : NULL, kept > 0 ? shape : NULL, out);
    }
    if (seen == PARTLY_WHOLE) {
        const double odds = expected_hidden(&out->after, shape, out->scatter, kept, rays.count);
        expected_learn(&out->after, shape, out->scatter, kept, odds);
        expected_learn_noise(&out->after, &noise, 1.0);
    }
    return seen == PARTLY_NOT ? MARKER_NONE : MARKER_FOUND;
}
