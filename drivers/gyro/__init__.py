"""Single-axis yaw gyros on I2C."""
