"""Fields: functions of position that a scene is made of."""
