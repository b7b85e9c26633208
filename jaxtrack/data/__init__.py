"""Recorded data on the host: files, local metres, scans, truth and tables of tracks.

Also to and from pandas, xarray, Stone Soup and the text form of MOTChallenge.
"""
