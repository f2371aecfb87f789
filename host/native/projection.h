// From the bending angle to the image, with the effects of kinematics, registration and camera, and its derivatives.
#ifndef TAUTLINE_PROJECTION_H
#define TAUTLINE_PROJECTION_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

// NAME(unit, meaning). Zero means absent. Turns are rotation vectors.
#define PROJECTION_PARAMETERS(X)                                                                                       \
    X(curvature_gradient, "", "kinematics.nonconstant_curvature: curvature from (1 - g) at the base to (1 + g)")       \
    X(curvature_by_bend, "1/rad",                                                                                      \
      "kinematics.nonconstant_curvature: added to g for each rad of the bending angle's size")                         \
    X(tilt_x, "deg", "registration.direction_dependent: turn at one side of the channel, less it at the other")        \
    X(tilt_y, "deg", "registration.direction_dependent")                                                               \
    X(tilt_z, "deg", "registration.direction_dependent")                                                               \
    X(tilt_pivot, "mm", "registration.direction_dependent: where on the base's z axis it turns")                       \
    X(static_rx, "deg", "registration.static: turn, then move")                                                        \
    X(static_ry, "deg", "registration.static")                                                                         \
    X(static_rz, "deg", "registration.static")                                                                         \
    X(static_x, "mm", "registration.static")                                                                           \
    X(static_y, "mm", "registration.static")                                                                           \
    X(static_z, "mm", "registration.static")                                                                           \
    X(shift_rx, "deg", "registration.shift: after the static one, from its time on")                                   \
    X(shift_ry, "deg", "registration.shift")                                                                           \
    X(shift_rz, "deg", "registration.shift")                                                                           \
    X(shift_x, "mm", "registration.shift")                                                                             \
    X(shift_y, "mm", "registration.shift")                                                                             \
    X(shift_z, "mm", "registration.shift")                                                                             \
    X(k1, "", "camera.distortion: added to the rig's")                                                                 \
    X(k2, "", "camera.distortion")                                                                                     \
    X(p1, "", "camera.distortion")                                                                                     \
    X(p2, "", "camera.distortion")                                                                                     \
    X(k3, "", "camera.distortion")

struct projection_parameters {
#define X(name, unit, meaning) double name;
    PROJECTION_PARAMETERS(X)
#undef X
};

// Of the bending angle, evenly spaced; between them a cubic with their own slopes (Catmull and Rom's), beyond them
// held.
enum { PROJECTION_PLACES = 65 };

// What the rig says; doubles alone, so that it can be filled in one go.
struct projection_rig {
    double bending_length, tip_length;  // mm
    double hand_eye[9], translation[3]; // X_cam = R X_base + t, R row by row
    double fx, fy, cx, cy;              // px
    double distortion[5];               // OpenCV's k1 k2 p1 p2 k3
    double place_from, place_step;      // deg; a step of 0: what is seen is at the tip's end
    double place[3][PROJECTION_PLACES]; // mm from there in the tip's own frame: aside in the plane it bends in, out of
                                        // that plane, ahead
};

// (count) each, or NULL for zeros.
struct projection_pose {
    const double *c_deg; // not NULL
    const double *translation, *rotation, *way;
    const unsigned char *shifted; // whether the registration's shift has happened
    size_t count;
};

enum { PROJECTION_STATIC = 6 };

// image (count, 2) px, NaN where a point is not in front of the camera. by_c (count, 2) px per deg of c and by_static
// (count, 2, 6) px per deg or mm of a further static registration (turn x y z, move x y z), or both NULL.
// About 0.15 us a point, 0.3 us with the derivatives.
void projection_image(const struct projection_parameters *e, const struct projection_rig *rig,
                      const struct projection_pose *pose, double *image, double *by_c, double *by_static);

#ifdef __cplusplus
}
#endif
#endif
