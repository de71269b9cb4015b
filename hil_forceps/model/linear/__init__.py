"""The linear plant: two inertias joined by an elastic wire, and its exact response over a step."""
