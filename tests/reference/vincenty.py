"""Geodesics on the WGS84 ellipsoid, one pair of points at a time.

Reference: Vincenty, "Direct and inverse solutions of geodesics on the ellipsoid with
application of nested equations", Survey Review 23(176), 1975.
"""

import math

MAJOR = 6378137.0
FLATTENING = 1.0 / 298.257223563


def inverse(lat1, lon1, lat2, lon2):
    """Distance in metres and azimuth at point 1, radians clockwise from north."""
    minor = MAJOR * (1 - FLATTENING)
    length = math.radians(lon2 - lon1)
    u1 = math.atan((1 - FLATTENING) * math.tan(math.radians(lat1)))
    u2 = math.atan((1 - FLATTENING) * math.tan(math.radians(lat2)))
    lam = length
    for _ in range(50):
        across = math.cos(u2) * math.sin(lam)
        along = math.cos(u1) * math.sin(u2) - math.sin(u1) * math.cos(u2) * math.cos(
            lam
        )
        sin_sigma = math.hypot(across, along)
        cos_sigma = math.sin(u1) * math.sin(u2) + math.cos(u1) * math.cos(
            u2
        ) * math.cos(lam)
        if sin_sigma == 0.0:
            return 0.0, 0.0
        sigma = math.atan2(sin_sigma, cos_sigma)
        sin_alpha = math.cos(u1) * math.cos(u2) * math.sin(lam) / sin_sigma
        cos2_alpha = 1 - sin_alpha**2
        middle = cos_sigma - 2 * math.sin(u1) * math.sin(u2) / cos2_alpha
        c = FLATTENING / 16 * cos2_alpha * (4 + FLATTENING * (4 - 3 * cos2_alpha))
        bracket = middle + c * cos_sigma * (2 * middle**2 - 1)
        lam = length + (1 - c) * FLATTENING * sin_alpha * (
            sigma + c * sin_sigma * bracket
        )
    u_squared = cos2_alpha * (MAJOR**2 - minor**2) / minor**2
    a = 1 + u_squared / 16384 * (
        4096 + u_squared * (-768 + u_squared * (320 - 175 * u_squared))
    )
    b = (
        u_squared
        / 1024
        * (256 + u_squared * (-128 + u_squared * (74 - 47 * u_squared)))
    )
    last = b / 6 * middle * (4 * sin_sigma**2 - 3) * (4 * middle**2 - 3)
    bracket = middle + b / 4 * (cos_sigma * (2 * middle**2 - 1) - last)
    return minor * a * (sigma - b * sin_sigma * bracket), math.atan2(across, along)
