"""Study many trainings: the paper's tables over seeds, statistics, comparisons, figures, trainings side by side."""
