// A thread of the system, which runs one block of a launch after another.
#pragma once

#include "device_launch.h"
#include "failure.h"
#include "fibers.h"
#include "scrambler.h"

#include <algorithm>
#include <memory>
#include <vector>

// What the threads of a launch run.
struct Launch {
    DeviceFunction function;
    void* argument;
    bool is_cooperative;  // whether threads may wait for others

    // Run a thread to its end; a failure ends it early.
    void call() const
    {
        try {
            function(argument);
        } catch (const ThreadEnded&) {
        }
    }
    static void call_on_fiber(void* launch) { ((const Launch*)launch)->call(); }
};

// A thread of the device.
struct DeviceThread {
    dim3 index { 0, 0, 0 };
    Fiber* fiber = nullptr;  // while it has begun and not ended
    bool is_ready = true, is_ended = false;
    // what it waits for: a collective of the lanes of a mask, or with no mask the whole block
    const char* waits_at = nullptr;
    unsigned mask = 0;
    uint64_t brought = 0;  // to the collective
    uint64_t seen[32];  // what the lanes have brought
};

class Processor {
public:
    explicit Processor(uint64_t seed)
        : scrambler_(seed)
    {
    }

    void run_block(dim3 block, unsigned num_threads, const Launch& launch)
    {
        current_ = this;
        blockIdx = block;
        if (launch.is_cooperative)
            run_together(num_threads, launch);
        else
            run_alone(num_threads, launch);
    }

    // --- for a thread of the device ---

    static Processor& current() { return *current_; }

    const uint64_t* exchange(const char* name, unsigned mask, uint64_t value)
    {
        DeviceThread& self = *self_;
        const unsigned lane = self.index.x % 32;
        if (!(mask >> lane & 1u))
            fail_launch("lane %u calls %s with mask %08x, which does not name it", lane, name, mask);
        self.brought = value;
        wait(name, mask);
        return self.seen;
    }

    void wait(const char* name, unsigned mask)
    {
        DeviceThread& self = *self_;
        self.waits_at = name;
        self.mask = mask;
        self.is_ready = false;
        self.fiber->yield();
    }

private:
    // Threads that never wait for another need no stack of their own.
    void run_alone(unsigned num_threads, const Launch& launch)
    {
        const ScrambledRange order(num_threads, scrambler_);
        for (unsigned k = 0; k < num_threads && !Failure::is_set(); ++k) {
            threadIdx = { (unsigned)order[k], 0, 0 };
            launch.call();
        }
    }

    void run_together(unsigned num_threads, const Launch& launch)
    {
        threads_.assign(num_threads, DeviceThread());
        for (unsigned k = 0; k < num_threads; ++k)
            threads_[k].index.x = k;
        const unsigned num_warps = (num_threads + 31) / 32;
        for (bool is_over = false; !is_over && !Failure::is_set();) {
            const ScrambledRange order(num_warps, scrambler_);
            for (unsigned k = 0; k < num_warps && !Failure::is_set(); ++k)
                run_warp(32 * (unsigned)order[k], launch);
            // all that have not ended wait for the block
            is_over = true;
            for (DeviceThread& thread : threads_) {
                is_over = is_over && thread.is_ended;
                thread.is_ready = true;
            }
        }
        // after a failure some have not ended; they are never resumed, and their stacks are used again
        for (DeviceThread& thread : threads_)
            if (thread.fiber)
                idle_.push_back(thread.fiber);
    }

    // Run the threads of a warp until each has ended or waits for the block.
    void run_warp(unsigned first, const Launch& launch)
    {
        const unsigned count = std::min(32u, (unsigned)threads_.size() - first);
        unsigned lanes[32];
        std::iota(lanes, lanes + count, first);
        for (bool is_any = true; is_any && !Failure::is_set();) {
            is_any = false;
            scrambler_.shuffle(lanes, count);
            for (unsigned k = 0; k < count && !Failure::is_set(); ++k) {
                DeviceThread& thread = threads_[lanes[k]];
                if (thread.is_ended || !thread.is_ready)
                    continue;
                is_any = true;
                run_thread(thread, launch);
                if (!thread.is_ended && thread.mask && !is_missed_by(thread, first, count))
                    meet(first, thread.mask);
            }
        }
        for (unsigned k = 0; k < count && !Failure::is_set(); ++k)
            if (const DeviceThread& thread = threads_[first + k]; !thread.is_ended && thread.mask)
                report_divergence(thread, first, count);
    }

    // Run a thread until it waits or ends.
    void run_thread(DeviceThread& thread, const Launch& launch)
    {
        self_ = &thread;
        threadIdx = thread.index;
        if (thread.fiber) {
            thread.fiber->resume();
        } else {
            if (idle_.empty()) {
                owned_.push_back(std::make_unique<Fiber>());
                idle_.push_back(owned_.back().get());
            }
            thread.fiber = idle_.back();
            idle_.pop_back();
            thread.fiber->start(&Launch::call_on_fiber, (void*)&launch);
        }
        if (!thread.fiber->is_running()) {
            thread.is_ended = true;
            idle_.push_back(thread.fiber);
            thread.fiber = nullptr;
        }
    }

    // A lane of the mask that has not arrived where a thread waits, as its number and one; 0 if all have.
    unsigned is_missed_by(const DeviceThread& waiting, unsigned first, unsigned count) const
    {
        for (unsigned k = 0; k < 32; ++k) {
            if (!(waiting.mask >> k & 1u))
                continue;
            if (k >= count)
                return k + 1;
            const DeviceThread& other = threads_[first + k];
            if (other.is_ended || other.is_ready || other.mask != waiting.mask || strcmp(other.waits_at, waiting.waits_at))
                return k + 1;
        }
        return 0;
    }

    // All lanes of a mask have arrived: let them go on, with what each has brought.
    void meet(unsigned first, unsigned mask)
    {
        for (unsigned k = 0; k < 32; ++k) {
            if (!(mask >> k & 1u))
                continue;
            DeviceThread& reader = threads_[first + k];
            reader.is_ready = true;
            for (unsigned j = 0; j < 32; ++j)
                if (mask >> j & 1u)
                    reader.seen[j] = threads_[first + j].brought;
        }
    }

    void report_divergence(const DeviceThread& waiting, unsigned first, unsigned count)
    {
        const unsigned lane = waiting.index.x % 32, missed = is_missed_by(waiting, first, count) - 1;
        const char* text = "divergence: lane %u of a warp waits at %s with mask %08x for lane %u, which ";
        if (missed >= count || threads_[first + missed].is_ended) {
            const std::string format = std::string(text) + (missed >= count ? "does not exist" : "has ended");
            Failure::record(format.c_str(), lane, waiting.waits_at, waiting.mask, missed);
        } else {
            const DeviceThread& other = threads_[first + missed];
            const std::string format = std::string(text) + "waits at %s with mask %08x";
            Failure::record(format.c_str(), lane, waiting.waits_at, waiting.mask, missed, other.waits_at, other.mask);
        }
    }

    static inline thread_local Processor* current_ = nullptr;
    Scrambler scrambler_;
    std::vector<DeviceThread> threads_;  // of the block
    DeviceThread* self_ = nullptr;  // which runs
    std::vector<std::unique_ptr<Fiber>> owned_;
    std::vector<Fiber*> idle_;
};
