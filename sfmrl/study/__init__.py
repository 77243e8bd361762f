"""Study what trainings lead to: the paper's tables over many seeds, statistics, comparison, trainings side by side."""
