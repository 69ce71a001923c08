"""The simulated Kinect's noise in the keys of a terravibe depth noise file."""

from __future__ import annotations

import math

from simulation.devices.kinect import KinectModel


def kinect_noise_file(model: KinectModel) -> dict[str, object]:
    """Return what a calibration of the simulated sensor would find.

    With d = a / z a disparity error of e pixels is one of e z^2 / a metres. Its noise and the
    spread of its steps, step / sqrt(12), are independent, so together they look like the spread
    of one wider step: k = sqrt(12 sigma^2 + step^2) / a. The floor and the angle term are those
    of the model; readings have no lateral error and share no noise. Noise of half a step blurs the
    steps: little of them is the same in all frames from one place.
    """
    step_px = math.hypot(math.sqrt(12.0) * model.sigma_disparity_px, model.disparity_step_px)
    return {
        "schema": "terravibe/depth-noise",
        "version": 1,
        "device": {"model": "simulated Kinect V1", "serial": ""},
        "model": {
            "name": "simulated-kinect",
            "axial_offset_m": model.floor_sigma_m,
            "axial_angle_m_sqrt_m": 0.0001,
            "quantum_per_m": step_px / model.disparity_px_m,
            "fixed_share": 0.1,
            "range_min_m": model.range_min_m,
            "range_max_m": model.range_max_m,
        },
    }


def recording_settings(model: KinectModel) -> dict[str, object]:
    """Return the settings of a simulated recording: the camera's noise, and its exact mount."""
    return {
        "depth_noise": kinect_noise_file(model),
        "mount_sigma_m": 0.0,
        "mount_sigma_rad": 0.0,
    }
