#include "rays.h"

#include <math.h>

#define WINDOW         3.0 /* tolerance: px to either side of the half-way crossing in which an edge is measured */
#define WINDOW_SAMPLES 13  /* 2 WINDOW / STEP + 1 */
#define BEYOND         3.0 /* tolerance: px beyond the crossing where the surroundings begin ... */
#define BEYOND_SAMPLES 6   /* ... and how far they are averaged */
#define LOW            0.2 /* tolerance: share of the contrast below which a sample is all surroundings */
#define HIGH           0.8 /* and above which it is all marker */

float rays_kth(float *x, int n, int k) {
    int low = 0, high = n - 1;
    while (low < high) {
        const float pivot = x[(low + high) / 2];
        int i = low, j = high;
        while (i <= j) {
            while (x[i] < pivot) {
                i++;
            }
            while (x[j] > pivot) {
                j--;
            }
            if (i <= j) {
                const float t = x[i];
                x[i++] = x[j];
                x[j--] = t;
            }
        }
        if (k <= j) {
            high = j;
        } else if (k >= i) {
            low = i;
        } else {
            break;
        }
    }
    return x[k];
}

/* Bilinear, at a place inside of the region and half a pixel and more from its right and lower rim. */
static inline float sample(const float *y, int columns, float px, float py) {
    const int ix = (int)px, iy = (int)py;
    const float fx = px - (float)ix, fy = py - (float)iy;
    const float *at = y + iy * columns + ix;
    const float upper = at[0] + fx * (at[1] - at[0]);
    const float lower = at[columns] + fx * (at[columns + 1] - at[columns]);
    return upper + fy * (lower - upper);
}

void rays_sample(const field_t *field, double cx, double cy, const double *basis, double r, int count, float *out) {
    const float *y = field->y;
    const int columns = field->columns, rows = field->rows;
    const float right = (float)columns - 1.001F, bottom = (float)rows - 1.001F;
    float px = (float)(cx + r * basis[1]), py = (float)(cy + r * basis[2]);
    const float dx = (float)(STEP * basis[1]), dy = (float)(STEP * basis[2]);
    const float ex = px + (float)count * dx, ey = py + (float)count * dy;
    if (fminf(px, ex) >= 0.0F && fminf(py, ey) >= 0.0F && fmaxf(px, ex) <= right && fmaxf(py, ey) <= bottom) {
        for (int i = 0; i < count; i++, px += dx, py += dy) {
            out[i] = sample(y, columns, px, py);
        }
        return;
    }
    for (int i = 0; i < count; i++, px += dx, py += dy) {
        out[i] = sample(y, columns, fminf(fmaxf(px, 0.0F), right), fminf(fmaxf(py, 0.0F), bottom));
    }
}

int rays_solve(double a[UNKNOWNS_MAX][UNKNOWNS_MAX], double b[UNKNOWNS_MAX], int n) {
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double s = a[i][j];
            for (int k = 0; k < j; k++) {
                s -= a[i][k] * a[j][k];
            }
            if (i == j) {
                if (s <= 1e-9) {
                    return 0;
                }
                a[i][i] = sqrt(s);
            } else {
                a[i][j] = s / a[j][j];
            }
        }
        for (int k = 0; k < i; k++) {
            b[i] -= a[i][k] * b[k];
        }
        b[i] /= a[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) {
            b[i] -= a[k][i] * b[k];
        }
        b[i] /= a[i][i];
    }
    return 1;
}

void rays_aim(rays_t *rays, double radius) {
    int count = 8 * (int)lround(2.0 * PI * radius / 8.0);
    rays->count = count = count < 24 ? 24 : count > MARKER_RAYS_MAX ? MARKER_RAYS_MAX : count;
    const double turn_cos = cos(2.0 * PI / count), turn_sin = sin(2.0 * PI / count);
    double along = 1.0, across = 0.0;
    for (int i = 0; i < count; i++) {
        double *b = rays->basis[i];
        b[0] = 1.0;
        b[1] = along;
        b[2] = across;
        along = b[1] * turn_cos - b[2] * turn_sin;
        across = b[2] * turn_cos + b[1] * turn_sin;
        for (int k = 2; 2 * k < TERMS; k++) {
            b[2 * k - 1] = b[2 * k - 3] * b[1] - b[2 * k - 2] * b[2];
            b[2 * k] = b[2 * k - 2] * b[1] + b[2 * k - 3] * b[2];
        }
    }
}

double rays_look_beyond(rays_t *rays, const field_t *field, uint8_t least, double cx, double cy, double reach) {
    const int columns = field->columns, rows = field->rows;
    double sum = 0.0;
    for (int i = 0; i < rays->count; i++) {
        const double dx = rays->basis[i][1], dy = rays->basis[i][2];
        double last = reach;
        for (; last > 0.0; last -= STEP) {
            const double px = cx + last * dx + 0.5, py = cy + last * dy + 0.5; /* truncated, the nearest pixel */
            if (px >= 0.0 && py >= 0.0 && px < columns && py < rows &&
                field->mark[(ptrdiff_t)py * columns + (ptrdiff_t)px] >= least) {
                break;
            }
        }
        rays->crossing[i] = last;
        float levels[BEYOND_SAMPLES], level = 0.0F;
        rays_sample(field, cx, cy, rays->basis[i], last + BEYOND, BEYOND_SAMPLES, levels);
        for (int k = 0; k < BEYOND_SAMPLES; k++) {
            level += levels[k];
        }
        rays->edge[i] = (double)level / BEYOND_SAMPLES;
        sum += rays->edge[i];
    }
    for (int i = 0; i < rays->count; i++) { /* of three neighbours */
        const int before = (i + rays->count - 1) % rays->count, after = (i + 1) % rays->count;
        rays->around[i] = (rays->edge[before] + rays->edge[i] + rays->edge[after]) / 3.0;
    }
    return sum / rays->count;
}

void rays_find_edges(rays_t *rays, const field_t *field, double cx, double cy, const double level[PLANE]) {
    for (int i = 0; i < rays->count; i++) {
        const double from = rays->crossing[i] > WINDOW ? rays->crossing[i] - WINDOW : 0.0;
        const double slope = level[1] * rays->basis[i][1] + level[2] * rays->basis[i][2];
        const double contrast = level[0] + slope * rays->crossing[i] - rays->around[i];
        rays->keep[i] = contrast > 0.0;
        rays->edge[i] = from;
        if (!rays->keep[i]) {
            continue;
        }
        float levels[WINDOW_SAMPLES], sum = 0.0F;
        rays_sample(field, cx, cy, rays->basis[i], from, WINDOW_SAMPLES, levels);
        const float scale = (float)(1.0 / (contrast * (HIGH - LOW))), zero = (float)(rays->around[i] + LOW * contrast);
        for (int k = 0; k < WINDOW_SAMPLES; k++) {
            const float share = (levels[k] - zero) * scale;
            sum += share < 0.0F ? 0.0F : share > 1.0F ? 1.0F : share;
        }
        rays->edge[i] = from + STEP * ((double)sum - 0.5); /* what lies before `from` counts in full */
    }
}
