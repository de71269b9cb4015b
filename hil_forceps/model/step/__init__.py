"""Steps of the plant with every effect: exact for its linear part; dry friction can stop or reverse within a step."""
