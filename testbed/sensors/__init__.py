"""Sensors: what turns geometry and motion into streams. One file a sensor."""
