"""Diagnosis of a calibrated model: where its predictions differ from recordings of the instrument (the gap), which
effect is the cause, and how far extending the model by it shrinks the gap.

Words of all modules: nominal model, the calibrated one without effects (B, f_remain, registration, delay); hypothesis,
a set of effects on top of the recalibrated nominal model; floor, one standard deviation of the sensor's noise; power, a
mean square of residuals; held out, of a block of manoeuvres by a fit without it; event, an effect without a path that
repeats; law, an effect with one exact equation; part, of the nominal model.
"""
