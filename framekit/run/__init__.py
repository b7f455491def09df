"""A run at work: its model, triggers, the scheduler, what blocks, commands and jobs do. No clock, no port, no task."""
