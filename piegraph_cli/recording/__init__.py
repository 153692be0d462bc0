"""What comes in: the recording folder layout, the camera model and calibration."""
