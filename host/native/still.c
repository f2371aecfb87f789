#include "still.h"

#include "lines.h"

#include <math.h>
#include <string.h>

enum { LONGEST = 32 };              // tolerance: frames of a mean
static const double LEAVES = 5.5;   // tolerance: sigma
static const double WOBBLE = 0.02;  // tolerance: of the swing
static const double RIDGE = 1e-11;  // tolerance: of a Gram matrix, a frame
static const double NO_WAY = 1e-12; // tolerance: of a ramp

// How far the mean of `block` frames from `at` on is from the mean of those before it, squared.
static double distance2(const double *total, size_t seen, size_t at, size_t block) {
    double sum = 0.0;
    for (size_t k = 0; k < seen; k++) {
        const double before = total[at * seen + k], ahead = total[(at + block) * seen + k] - before;
        const double apart = ahead / (double)block - before / (double)at;
        sum += apart * apart;
    }
    return sum;
}

static int left_at(const double *total, size_t seen, size_t at, size_t block, double wobble) {
    const double level = LEAVES * sqrt(1.0 / (double)block + 1.0 / (double)at), least = fmax(level, wobble);
    return distance2(total, seen, at, block) > least * least;
}

size_t still_until(const double *z, size_t n, size_t seen, double *total) {
    double swing2 = 0.0;
    memset(total, 0, seen * sizeof *total);
    for (size_t i = 0; i < n; i++) {
        double far2 = 0.0;
        for (size_t k = 0; k < seen; k++) {
            const double apart = z[i * seen + k] - z[k];
            total[(i + 1) * seen + k] = total[i * seen + k] + apart;
            far2 += apart * apart;
        }
        swing2 = fmax(swing2, far2);
    }
    const double wobble = WOBBLE * sqrt(swing2);
    size_t first = n;
    for (size_t block = 1; n > 2 && block <= LONGEST && block < n; block *= 2) {
        // Later ones are of no use: frame at + block - 1 is where this block sees it.
        const size_t twice = block == 1 ? 1 : 0;
        for (size_t at = 1; at + block + twice <= n && at + block - 1 < first; at++) {
            if (left_at(total, seen, at, block, wobble) && (!twice || left_at(total, seen, at + 1, 1, wobble))) {
                first = at + block - 1;
            }
        }
    }
    return first;
}

// Cholesky's factor of gram (size), in its place: its ridge is far above what rounding takes off a pivot.
static void factorise(double gram[STILL_ORDERS + 1][STILL_ORDERS + 1], size_t size) {
    for (size_t i = 0; i < size; i++) {
        for (size_t j = 0; j <= i; j++) {
            for (size_t k = 0; k < j; k++) {
                gram[i][j] -= gram[i][k] * gram[j][k];
            }
            gram[i][j] = i == j ? sqrt(gram[i][i]) : gram[i][j] / gram[j][j];
        }
    }
}

// right' gram^-1 right, by the factor.
static double taken_off(double gram[STILL_ORDERS + 1][STILL_ORDERS + 1], const double *right, size_t size) {
    double forward[STILL_ORDERS + 1], sum = 0.0;
    for (size_t i = 0; i < size; i++) {
        forward[i] = right[i];
        for (size_t j = 0; j < i; j++) {
            forward[i] -= gram[i][j] * forward[j];
        }
        forward[i] /= gram[i][i];
        sum += forward[i] * forward[i];
    }
    return sum;
}

// What does not change with the delay: sums over the frames of y, which is z less its first value.
typedef struct {
    double first[STILL_SEEN], squares;
} fixed_t;

static fixed_t fixed_of(const struct still_stop *stop) {
    fixed_t fixed = {{0}, 0.0};
    for (size_t i = 0; i < stop->frames; i++) {
        for (size_t k = 0; k < stop->seen; k++) {
            const double y = stop->z[i * stop->seen + k] - stop->z[k];
            fixed.first[k] += y;
            fixed.squares += y * y;
        }
    }
    return fixed;
}

static double squares_of(const struct still_stop *stop, const fixed_t *fixed, const double *ramp, double most) {
    const size_t size = (size_t)stop->order + 1;
    double moments[2 * STILL_ORDERS + 1] = {(double)stop->frames}, right[STILL_SEEN][STILL_ORDERS + 1] = {{0}};
    double gram[STILL_ORDERS + 1][STILL_ORDERS + 1], sum = fixed->squares;
    for (size_t i = 0; i < stop->frames; i++) {
        const double unit = ramp[i] / most, square = unit * unit;
        if (unit == 0.0) {
            continue;
        }
        const double powers[] = {unit, square, unit * square, square * square};
        for (size_t a = 0; a < 2 * STILL_ORDERS; a++) {
            moments[a + 1] += powers[a];
        }
        for (size_t k = 0; k < stop->seen; k++) {
            const double y = stop->z[i * stop->seen + k] - stop->z[k];
            right[k][1] += unit * y;
            right[k][2] += square * y;
        }
    }
    for (size_t a = 0; a < size; a++) {
        for (size_t b = 0; b < size; b++) {
            gram[a][b] = moments[a + b] + (a == b ? RIDGE * (double)stop->frames : 0.0);
        }
    }
    factorise(gram, size);
    for (size_t k = 0; k < stop->seen; k++) {
        right[k][0] = fixed->first[k];
        sum -= taken_off(gram, right[k], size);
    }
    return sum < 0.0 ? 0.0 : sum; // NaN stays: a place that is none is no perfect stop
}

void still_squares(const struct still_stop *stop, const double *delays, size_t count, double *ramp, double *squares) {
    const fixed_t fixed = fixed_of(stop);
    const struct lines motor = lines_of(stop->motor_s, stop->motor_q, stop->readings);
    size_t from = 0;
    for (size_t d = 0; d < count; d++) {
        double most = NO_WAY;
        for (size_t i = 0; i < stop->frames; i++) {
            const double scene = stop->arrival_s[i] - delays[d];
            const int before = scene < stop->turn_s; // after it the image is level, wherever the motor is
            ramp[i] = before ? fmin(stop->direction * (lines_at(&motor, scene, &from) - stop->q1), 0.0) : 0.0;
            most = fmax(most, fabs(ramp[i]));
        }
        squares[d] = squares_of(stop, &fixed, ramp, most);
    }
}
