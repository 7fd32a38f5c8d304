// SPDX-License-Identifier: Apache-2.0

// Solves a BAL file in two goes: a callback stops the first, the second runs to the end.
//
//	go build -o solve solve.go && ./solve FILE
package main

import (
	"errors"
	"fmt"
	"os"

	"clba.example/clba"
)

func show(row *clba.Iteration) { fmt.Printf("%3d  cost %.6e\n", row.Iteration, row.Cost) }

func solve(file string) error {
	if err := clba.CheckVersion(); err != nil {
		return err
	}
	problem, err := clba.ReadBAL(file)
	if err != nil {
		return err
	}
	defer problem.Close()
	context, err := clba.NewContext()
	if err != nil {
		return err
	}
	defer context.Close()

	stopped, err := problem.Solve(context, func(row *clba.Iteration) bool {
		show(row)
		return row.Iteration < 3
	})
	if err != nil {
		return err
	}
	defer stopped.Close()
	halfWay, err := stopped.Summary()
	if err != nil {
		return err
	}
	if !halfWay.StoppedByUser {
		return errors.New("not stopped by the callback")
	}
	fmt.Printf("stopped at %.16e\n", halfWay.FinalCost)

	// It goes on from the state that the first solve left.
	result, err := problem.Solve(context, func(row *clba.Iteration) bool {
		show(row)
		return true
	})
	if err != nil {
		return err
	}
	defer result.Close()
	summary, err := result.Summary()
	if err != nil {
		return err
	}
	fmt.Print(result.Report())
	fmt.Printf("final cost %.16e\n", summary.FinalCost)
	return nil
}

func main() {
	if len(os.Args) != 2 {
		fmt.Fprintln(os.Stderr, "usage: solve FILE")
		os.Exit(1)
	}
	if err := solve(os.Args[1]); err != nil {
		fmt.Fprintln(os.Stderr, err)
		os.Exit(1)
	}
}
