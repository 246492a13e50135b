"""What is shown: drawings on the processor, interactive views, and the still picture of a report."""
