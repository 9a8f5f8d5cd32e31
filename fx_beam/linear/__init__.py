"""Small deviations about a state: `modes`, `frequency_response` and `linearise`."""
