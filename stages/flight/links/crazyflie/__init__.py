"""Link to Crazyflies over CRTP."""
