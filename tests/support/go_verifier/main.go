// Checks a lab's signed note and its proofs with Go's own implementation of transparency logs,
// which shares no code with LabOS. Reads one question as JSON and answers "ok", or says what is wrong.
package main

import (
	"encoding/base64"
	"encoding/json"
	"fmt"
	"os"
	"strconv"
	"strings"

	"golang.org/x/mod/sumdb/note"
	"golang.org/x/mod/sumdb/tlog"
)

type question struct {
	Key     string   `json:"key"`
	Note    []byte   `json:"note"`
	Records []record `json:"records"`
	Older   []older  `json:"older"`
}

type record struct {
	Index int64    `json:"index"`
	Data  []byte   `json:"data"`
	Proof [][]byte `json:"proof"`
}

type older struct {
	Size  int64    `json:"size"`
	Root  []byte   `json:"root"`
	Proof [][]byte `json:"proof"`
}

func main() {
	if err := answer(); err != nil {
		fmt.Println(err)
		os.Exit(1)
	}
	fmt.Println("ok")
}

func answer() error {
	var asked question
	if err := json.NewDecoder(os.Stdin).Decode(&asked); err != nil {
		return err
	}
	verifier, err := note.NewVerifier(asked.Key)
	if err != nil {
		return err
	}
	opened, err := note.Open(asked.Note, note.VerifierList(verifier))
	if err != nil {
		return err
	}
	lines := strings.Split(opened.Text, "\n")
	size, err := strconv.ParseInt(lines[1], 10, 64)
	if err != nil {
		return err
	}
	root, err := hash(lines[2])
	if err != nil {
		return err
	}
	for _, each := range asked.Records {
		leaf := tlog.RecordHash(each.Data)
		if err := tlog.CheckRecord(tlog.RecordProof(hashes(each.Proof)), size, root, each.Index, leaf); err != nil {
			return fmt.Errorf("record %d: %w", each.Index, err)
		}
	}
	for _, each := range asked.Older {
		var before tlog.Hash
		copy(before[:], each.Root)
		if err := tlog.CheckTree(tlog.TreeProof(hashes(each.Proof)), size, root, each.Size, before); err != nil {
			return fmt.Errorf("tree of %d: %w", each.Size, err)
		}
	}
	return nil
}

func hash(text string) (found tlog.Hash, err error) {
	raw, err := base64.StdEncoding.DecodeString(text)
	copy(found[:], raw)
	return found, err
}

func hashes(raw [][]byte) []tlog.Hash {
	found := make([]tlog.Hash, len(raw))
	for at, each := range raw {
		copy(found[at][:], each)
	}
	return found
}
