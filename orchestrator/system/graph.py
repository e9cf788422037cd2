"""Groups of a graph that depend on each other in a circle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from orchestrator.system.system import Port

Graph = Mapping[Port, Iterable[Port]]  # node -> nodes that must be known before


def components(graph: Graph) -> list[list[Port]]:
    """Strongly connected groups, each after the groups it depends on (Tarjan's algorithm)."""
    index: dict[Port, int] = {}
    low: dict[Port, int] = {}
    stack: list[Port] = []
    on_stack: set[Port] = set()
    groups: list[list[Port]] = []
    for root in graph:
        work: list[tuple[Port, Iterator[Port]]] = [] if root in index else [(root, iter(()))]
        while work:
            node, remaining = work[-1]
            if node not in index:
                index[node] = low[node] = len(index)
                stack.append(node)
                on_stack.add(node)
                remaining = iter(graph[node])
                work[-1] = (node, remaining)
            for before in remaining:
                if before not in index:
                    work.append((before, iter(())))
                    break
                if before in on_stack:
                    low[node] = min(low[node], index[before])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    groups.append(_pop(stack, on_stack, node))
    return groups


def _pop(stack: list[Port], on_stack: set[Port], node: Port) -> list[Port]:
    """The group that ends with `node`."""
    group: list[Port] = []
    while not group or group[-1] != node:
        group.append(stack.pop())
        on_stack.discard(group[-1])
    return group[::-1]


def circular(graph: Graph, group: list[Port]) -> bool:
    """Do the nodes of a strongly connected group depend on themselves?"""
    return len(group) > 1 or group[0] in graph[group[0]]


def circle(graph: Graph, group: list[Port]) -> list[Port]:
    """One way round in a circular group; it ends where it begins, and each node needs the one before it."""
    path, inside = [group[0]], set(group)
    while True:
        before = next(p for p in graph[path[-1]] if p in inside)
        if before in path:
            return [*path[path.index(before) :], before][::-1]
        path.append(before)
