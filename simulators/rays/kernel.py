"""The compiled part of `simulators.rays.rays`. Importing it takes a second, so it is imported where rays are traced.

Lengths are in pitches: a cell of the grid has side one. A ray is followed cell by cell, over blocks of 8 x 8 cells and
over blocks of 8 x 8 of those that it passes above. The surface is a function z(x, y), and the ray starts above it: so
it meets a triangle if it leaves the triangle's column below the triangle's plane. Neighbouring columns share the point
where one is left and the other entered, so that no ray slips through between two triangles.
"""

from math import floor, sqrt

from numba import njit

from drivers.arrays import CountArray, FloatArray

ESCAPED, EDGE, STOPPED = 0, 1, 2
"""How a path ends: above the surface, through the side of a finite patch, at the limit of reflections.

A ray that runs level through a periodic surface would have no end; it is taken as lost through the side."""

FAR = 1e300
"""A way that is longer than all others, for rays that run along a grid line."""


@njit(cache=True, nogil=True, error_model="numpy")
def follow(  # noqa: PLR0912, PLR0915
    heights: FloatArray,
    blocks: FloatArray,
    large_blocks: FloatArray,
    top: float,
    periodic: bool,
    origins: FloatArray,
    directions: FloatArray,
    limit: int,
    ends: CountArray,
    reflections: CountArray,
    out_directions: FloatArray,
    cosines: FloatArray,
) -> None:
    """Follow rays from above the surface until each has ended; the last four arguments are filled.

    `heights` [ny + 1, nx + 1] of the corners of all cells; `blocks`, `large_blocks` the highest corner in blocks of
    8 x 8 and 64 x 64 cells, `top` the highest of all; `origins` [rays, 3] at or above `top` and with x, y within the
    patch; `directions` [rays, 3] of length one. Out come `ends` [rays], `reflections` [rays], `out_directions`
    [rays, 3] and `cosines` [limit, rays] of the angle of incidence of each reflection.
    """
    ny, nx = heights.shape[0] - 1, heights.shape[1] - 1
    for ray in range(origins.shape[0]):
        ox, oy, oz = origins[ray, 0], origins[ray, 1], origins[ray, 2]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
        ix, iy = min(max(floor(ox), 0), nx - 1), min(max(floor(oy), 0), ny - 1)
        inverse_x, inverse_y = 1.0 / dx, 1.0 / dy
        east, north = dx > 0, dy > 0
        way = 0.0  # from the origin, which moves to each reflection
        count = 0
        end = -1
        while end < 0:
            z = oz + way * dz
            if z >= top and dz >= 0:
                end = ESCAPED
                break
            # The largest block above which the ray stays until it leaves it is passed at once; else one cell is.
            bits = 0
            bx, by = ix >> 3, iy >> 3
            high = blocks[by, bx]
            x1 = min((bx + 1) << 3, nx) if east else bx << 3
            y1 = min((by + 1) << 3, ny) if north else by << 3
            leave_x = (x1 - ox) * inverse_x if dx != 0 else FAR
            leave_y = (y1 - oy) * inverse_y if dy != 0 else FAR
            leave = min(leave_x, leave_y)
            lowest = oz + leave * dz if dz < 0 else z
            if lowest >= high:
                bits = 3
                bx, by = ix >> 6, iy >> 6
                high = large_blocks[by, bx]
                if z >= high:
                    x2 = min((bx + 1) << 6, nx) if east else bx << 6
                    y2 = min((by + 1) << 6, ny) if north else by << 6
                    far_x = (x2 - ox) * inverse_x if dx != 0 else FAR
                    far_y = (y2 - oy) * inverse_y if dy != 0 else FAR
                    far = min(far_x, far_y)
                    if dz >= 0 or oz + far * dz >= high:
                        bits = 6
                        x1, y1, leave_x, leave_y, leave = x2, y2, far_x, far_y, far
            if bits == 0:
                # Cell by cell until the block is left or the surface met.
                block_x, block_y = ix >> 3, iy >> 3
                step_x, step_y = 1 if east else -1, 1 if north else -1
                leave_x = (ix + (1 if east else 0) - ox) * inverse_x if dx != 0 else FAR
                leave_y = (iy + (1 if north else 0) - oy) * inverse_y if dy != 0 else FAR
                per_x, per_y = abs(inverse_x), abs(inverse_y)
                while True:
                    leave = min(leave_x, leave_y)
                    z1 = oz + leave * dz
                    h00, h10 = heights[iy, ix], heights[iy, ix + 1]
                    h01, h11 = heights[iy + 1, ix], heights[iy + 1, ix + 1]
                    if min(z, z1) < max(h00, h10, h01, h11):
                        u, v = ox - ix, oy - iy
                        along = dx - dy
                        enter_side = u - v + way * along
                        leave_side = u - v + leave * along
                        crossing = (v - u) / along if enter_side * leave_side < 0 else leave
                        first = enter_side >= 0 if enter_side * leave_side < 0 else enter_side + leave_side >= 0
                        met = False
                        low, high_way = way, crossing
                        a, b, found, rise = 0.0, 0.0, 0.0, 0.0
                        for _ in range(2):
                            if first:  # the triangle with two corners in the row of lower index
                                a, b = h10 - h00, h11 - h10
                            else:
                                a, b = h11 - h01, h01 - h00
                            rise = dz - a * dx - b * dy
                            above = oz - h00 - a * u - b * v
                            if rise < 0 and above + rise * high_way < 0:
                                met = True
                                found = min(max(-above / rise, low), high_way)
                                break
                            if high_way >= leave:
                                break
                            low, high_way = crossing, leave
                            first = not first
                        if met:
                            if count == limit:
                                end = STOPPED
                                break
                            # r = d - 2 (d . n) n with n = (-a, -b, 1) / sqrt(1 + a^2 + b^2), d . n = rise / sqrt(...)
                            square = 1.0 / (1.0 + a * a + b * b)
                            cosines[count, ray] = -rise * sqrt(square)
                            count += 1
                            ox, oy, oz = ox + found * dx, oy + found * dy, oz + found * dz
                            twice = 2.0 * rise * square
                            dx, dy, dz = dx + twice * a, dy + twice * b, dz - twice
                            inverse_x, inverse_y = 1.0 / dx, 1.0 / dy
                            east, north = dx > 0, dy > 0
                            way = 0.0
                            break
                    way, z = leave, z1
                    if leave_x < leave_y:
                        ix += step_x
                        leave_x += per_x
                        if ix < 0 or ix >= nx:
                            if not periodic or dz == 0:
                                end = ESCAPED if z >= top and dz >= 0 else EDGE
                                break
                            shift = nx if ix < 0 else -nx
                            ix += shift
                            ox += shift
                            break
                        if ix >> 3 != block_x:
                            break
                    else:
                        iy += step_y
                        leave_y += per_y
                        if iy < 0 or iy >= ny:
                            if not periodic or dz == 0:
                                end = ESCAPED if z >= top and dz >= 0 else EDGE
                                break
                            shift = ny if iy < 0 else -ny
                            iy += shift
                            oy += shift
                            break
                        if iy >> 3 != block_y:
                            break
                continue
            # Above a block: on to the cell behind it.
            if dz >= 0 and oz + leave * dz >= top:
                end = ESCAPED
                break
            way = leave
            if leave_x < leave_y:
                low_y, high_y = (iy >> bits) << bits, min(((iy >> bits) + 1) << bits, ny) - 1
                iy = min(max(floor(oy + leave * dy), low_y), high_y)
                ix = x1 if east else x1 - 1
                if ix < 0 or ix >= nx:
                    if not periodic or dz == 0:
                        end = EDGE
                        break
                    shift = nx if ix < 0 else -nx
                    ix += shift
                    ox += shift
            else:
                low_x, high_x = (ix >> bits) << bits, min(((ix >> bits) + 1) << bits, nx) - 1
                ix = min(max(floor(ox + leave * dx), low_x), high_x)
                iy = y1 if north else y1 - 1
                if iy < 0 or iy >= ny:
                    if not periodic or dz == 0:
                        end = EDGE
                        break
                    shift = ny if iy < 0 else -ny
                    iy += shift
                    oy += shift
        ends[ray] = end
        reflections[ray] = count
        out_directions[ray, 0], out_directions[ray, 1], out_directions[ray, 2] = dx, dy, dz


@njit(cache=True, nogil=True)
def weigh(reflections: CountArray, cosines: FloatArray, table: FloatArray, weights: FloatArray) -> None:
    """Multiply `weights` [rays, wavelengths] with the reflectance of each reflection of each ray.

    `table` [nodes, wavelengths] is the reflectance at cosines evenly from 0 to 1, between which it is linear; `cosines`
    are [limit, rays].
    """
    last = table.shape[0] - 1
    for ray in range(weights.shape[0]):
        for number in range(reflections[ray]):
            place = min(cosines[number, ray], 1.0) * last
            node = min(int(place), last - 1)
            part = place - node
            for wavelength in range(weights.shape[1]):
                low, high = table[node, wavelength], table[node + 1, wavelength]
                weights[ray, wavelength] *= low + part * (high - low)
