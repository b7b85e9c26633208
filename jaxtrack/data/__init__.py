"""Recorded data on the host: files, local metres, scans, truth and tables of tracks."""
