"""Device memory: areas, watches over them, snapshots and profiles."""
