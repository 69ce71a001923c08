"""Where the rover is, from vibration, gyro and wheels: poses with a covariance."""
