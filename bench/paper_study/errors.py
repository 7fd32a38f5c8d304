# SPDX-License-Identifier: Apache-2.0
"""Errors of camera centres after the similarity that fits them best."""
import numpy as np


def similarity_parameters(centers, truth):
    """Scale, rotation and shift that take centers nearest to truth in least squares (Umeyama 1991)."""
    mean, true_mean = centers.mean(axis=0), truth.mean(axis=0)
    u, singular, vt = np.linalg.svd((truth - true_mean).T @ (centers - mean))
    signs = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    scale = (singular * signs).sum() / ((centers - mean) ** 2).sum()
    rotation = u * signs @ vt
    return scale, rotation, true_mean - scale * rotation @ mean


def similarity(centers, truth):
    """The same as a function of points."""
    scale, rotation, shift = similarity_parameters(centers, truth)
    return lambda points: scale * points @ rotation.T + shift


def position_errors(centers, truth):
    """Root mean square distance, in units of truth; and the paper's eq. 13, in percent: the mean over
    images and coordinates of |difference / true coordinate|."""
    difference = similarity(centers, truth)(centers) - truth
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.abs(difference / truth)
    return {"rmse": float(np.sqrt((difference**2).sum(axis=1).mean())),
            "eq13": 100 * float(ratios[np.isfinite(ratios)].mean())}
