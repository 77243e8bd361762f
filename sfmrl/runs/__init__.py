"""Run folders: their files, the runs in them, and trainings that save, stop and go on."""
