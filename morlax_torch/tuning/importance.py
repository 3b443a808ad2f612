"""Which options decide whether a trial is among the best."""

from .library import optuna
from .storage import quiet
from .study import Study

FEWEST = 10  # trials


def importances(study: Study) -> dict[str, float]:
    """Return the share of each option in what makes good trials differ, the largest first.

    PED-ANOVA compares the options of the best trials with those of all. Only ranks count, so pruned
    trials count too, with what they had reached. Of several indicators, hypervolume counts. Empty
    if there are fewer than FEWEST trials.
    """
    trials = study.trials_with_options()
    if len(trials) < FEWEST:
        return {}
    main = study.plan.main
    with quiet():
        copy = optuna.create_study(direction="maximize" if study.plan.sign > 0 else "minimize")
        for trial in trials:
            copy.add_trial(
                optuna.trial.create_trial(
                    params=trial.params,
                    distributions=trial.distributions,
                    value=trial.user_attrs["indicators"][main],
                )
            )
        evaluator = optuna.importance.PedAnovaImportanceEvaluator()
        return optuna.importance.get_param_importances(copy, evaluator=evaluator)
