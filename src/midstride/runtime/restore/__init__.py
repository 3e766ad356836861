"""The way back to what the specification asks for: after a crash, a degradation, or the end of a manager."""

PUBLIC = "BringUp FallbackLeases HALF_DONE Respawner ReturnedHosts Restorer require_same_platform require_spoken"
