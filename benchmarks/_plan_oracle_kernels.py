"""Kernel of the exact oracle: Dijkstra over robot cells times obstacle positions."""

from __future__ import annotations

import numpy as np

from visuohaptic.core.kernels import kernel

NEVER = np.int32(2**31 - 1)


@kernel
def cell_price(
    cell: int,
    at_rows: np.ndarray,
    at_columns: np.ndarray,
    clearance: np.ndarray,
    near: np.ndarray,
    near_low: np.ndarray,
    shifts: np.ndarray,
    p0: int,
    p1: int,
    bodies: int,
    radius: float,
    slow: float,
) -> float:
    """Cost of a cell, Eq. (4.1), with both bodies where they are [cells at full speed]."""
    d = clearance[cell]
    for b in range(bodies):
        place = p0 if b == 0 else p1
        r = at_rows[cell] - shifts[b, place, 1] - near_low[b, 1]
        c = at_columns[cell] - shifts[b, place, 0] - near_low[b, 0]
        if 0 <= r < near.shape[1] and 0 <= c < near.shape[2]:
            d = min(d, near[b, r, c])
    fraction = min((d / radius - 1.0) * 0.5, 1.0)
    return slow + fraction * (1.0 - slow)


@kernel
def product_search(
    move_cells: np.ndarray,
    move_start: np.ndarray,
    move_length: np.ndarray,
    at_rows: np.ndarray,
    at_columns: np.ndarray,
    clearance: np.ndarray,
    near: np.ndarray,
    near_low: np.ndarray,
    shifts: np.ndarray,
    radius: float,
    slow: float,
    units: int,
    blocks: np.ndarray,
    blocks_start: np.ndarray,
    together: np.ndarray,
    places: np.ndarray,
    push_body: np.ndarray,
    push_next: np.ndarray,
    push_free: np.ndarray,
    tables: np.ndarray,
    link_cells: np.ndarray,
    link_cost: np.ndarray,
    cells: int,
    start: int,
    start_places: np.ndarray,
    goals: np.ndarray,
    goal_cost: np.ndarray,
) -> tuple[int, int]:
    """Cheapest path of robot and obstacles together to the goal; cost and number of states settled.

    A state is (place of body 0, place of body 1, robot), the robot on one of
    ``cells`` cells or at the approach pose of one of the pushes. All costs are whole units.

    Parameters
    ----------
    move_cells, move_start, move_length
        Neighbours of every cell on the map without bodies, CSR, and how far they are [cells].
    at_rows, at_columns, clearance
        Of every cell: its place, and its distance to what never moves.
    near, near_low, shifts
        Distance patch of each body where the map has it, its lowest (x, y), and the shifts of its places.
    radius, slow, units
        Of the robot [cells], v_max / v_min, units of cost per cell at full speed.
    blocks, blocks_start
        For each body and place (flat: body * most + place), the sorted cells that it denies the robot.
    together
        Whether both bodies may be at their places at once (places0 x places1).
    places
        Number of places of each body.
    push_body
        Body of each push.
    push_next
        Place after one cell of a push, by push and place; -1 where it ends.
    push_free
        Whether the robot fits behind the body, by push and place.
    tables
        Cost of a push by push and whole cells.
    link_cells, link_cost
        Cells around the approach pose of a push and the cost of moving there, by push and place, -1 padded.
    """
    bodies = len(places)
    pushes = len(push_body)
    robots = cells + pushes
    second = places[1] if bodies > 1 else 1
    total = (places[0] if bodies > 0 else 1) * second * robots
    cost = np.full(total, NEVER, np.int32)
    most = len(blocks_start) - 1
    per_body = most // max(bodies, 1)
    top = int(slow * units * 1.5) + 1
    if pushes > 0:
        for p in range(pushes):
            for s in range(tables.shape[1]):
                if tables[p, s] < NEVER:
                    top = max(top, tables[p, s])
        top = max(top, link_cost.max())
    count = top + 2
    heads = np.full(count, -1, np.int64)
    capacity = 1 << 16
    pool = np.empty(capacity, np.int64)
    chain = np.empty(capacity, np.int64)
    used = 0
    free = -1
    denied = np.zeros(cells, np.int32)
    stamp = 0
    stamped = np.int64(-1)
    goal_extra = np.full(cells, NEVER, np.int32)
    for i in range(len(goals)):
        goal_extra[goals[i]] = goal_cost[i]
    first = start_places[0] if bodies > 0 else 0
    other = start_places[1] if bodies > 1 else 0
    origin = (first * second + other) * robots + start
    cost[origin] = 0
    pool[0], chain[0], heads[0], used = origin, -1, 0, 1
    waiting = 1
    level = 0
    settled = 0
    best = NEVER
    found_state = np.zeros(400, np.int64)
    found_cost = np.zeros(400, np.int32)
    while waiting > 0 and level < best:
        slot = level % count
        while heads[slot] >= 0:
            entry = heads[slot]
            heads[slot] = chain[entry]
            chain[entry] = free
            free = entry
            waiting -= 1
            state = pool[entry]
            if cost[state] != level:
                continue
            settled += 1
            robot = state % robots
            config = state // robots
            p0, p1 = config // second, config % second
            if config != stamped:
                stamped = config
                stamp += 1
                for b in range(bodies):
                    k = b * per_body + (p0 if b == 0 else p1)
                    for i in range(blocks_start[k], blocks_start[k + 1]):
                        denied[blocks[i]] = stamp
            number = 0
            if robot < cells:
                if goal_extra[robot] < NEVER:
                    best = min(best, level + goal_extra[robot])
                here = cell_price(
                    robot,
                    at_rows,
                    at_columns,
                    clearance,
                    near,
                    near_low,
                    shifts,
                    p0,
                    p1,
                    bodies,
                    radius,
                    slow,
                )
                for i in range(move_start[robot], move_start[robot + 1]):
                    v = move_cells[i]
                    if denied[v] != stamp:
                        there = cell_price(
                            v,
                            at_rows,
                            at_columns,
                            clearance,
                            near,
                            near_low,
                            shifts,
                            p0,
                            p1,
                            bodies,
                            radius,
                            slow,
                        )
                        found_state[number] = config * robots + v
                        found_cost[number] = int(0.5 * (here + there) * move_length[i] * units + 0.5)
                        number += 1
                for p in range(pushes):
                    place = p0 if push_body[p] == 0 else p1
                    middle = link_cells[p, place, 0]
                    if middle < 0 or denied[middle] == stamp:
                        continue  # another body is where the robot would be
                    for i in range(link_cells.shape[2]):
                        if link_cells[p, place, i] == robot:
                            found_state[number] = config * robots + cells + p
                            found_cost[number] = link_cost[p, place, i]
                            number += 1
            else:
                p = robot - cells
                body = push_body[p]
                place = p0 if body == 0 else p1
                for i in range(link_cells.shape[2]):
                    v = link_cells[p, place, i]
                    if v >= 0 and denied[v] != stamp:
                        found_state[number] = config * robots + v
                        found_cost[number] = link_cost[p, place, i]
                        number += 1
                at = place
                for steps in range(1, tables.shape[1]):
                    if tables[p, steps] >= NEVER or not push_free[p, at]:
                        break
                    at = push_next[p, at]
                    if at < 0 or not push_free[p, at]:
                        break
                    q0, q1 = (at, p1) if body == 0 else (p0, at)
                    if bodies > 1 and not together[q0, q1]:
                        break
                    # The robot, too, must not run into the other body.
                    clear = True
                    if bodies > 1:
                        other_body = 1 - body
                        k = other_body * per_body + (q0 if other_body == 0 else q1)
                        middle = link_cells[p, at, 0]
                        for i in range(blocks_start[k], blocks_start[k + 1]):
                            clear = clear and blocks[i] != middle
                    if not clear:
                        break
                    found_state[number] = (q0 * second + q1) * robots + robot
                    found_cost[number] = tables[p, steps]
                    number += 1
            for i in range(number):
                total_cost = level + found_cost[i]
                target = found_state[i]
                if total_cost < cost[target]:
                    cost[target] = total_cost
                    if free >= 0:
                        entry = free
                        free = chain[entry]
                    else:
                        if used == capacity:
                            pool2 = np.empty(capacity * 2, np.int64)
                            chain2 = np.empty(capacity * 2, np.int64)
                            pool2[:capacity] = pool
                            chain2[:capacity] = chain
                            pool, chain, capacity = pool2, chain2, capacity * 2
                        entry = used
                        used += 1
                    pool[entry] = target
                    where = total_cost % count
                    chain[entry] = heads[where]
                    heads[where] = entry
                    waiting += 1
        level += 1
    return int(best), settled
