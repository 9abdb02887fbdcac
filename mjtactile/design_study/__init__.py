"""Prediction of a sensor file's performance before the sensor is built or simulated.

The quasi-static membrane predicts the markers' positions on an indenter. The camera's error bound
predicts their accuracy. The sensing pipeline's own covariance predicts the accuracy of the
estimates.
"""
